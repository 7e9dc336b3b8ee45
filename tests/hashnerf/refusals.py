"""Whether a call is refused, as a number that a row can count: `pytest.raises` would stop before it is measured."""

import re
from collections.abc import Callable

from hashnerf.errors import UserError


def refuses(sentence: str, call: Callable[..., object], *arguments: object) -> bool:
    """Whether the call raises a UserError in which the sentence is found."""
    try:
        call(*arguments)
    except UserError as error:
        return re.search(sentence, str(error)) is not None
    return False
