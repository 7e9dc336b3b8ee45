"""Loading a run that is not one. A trained run is loaded in tests/e2e."""

import pytest

from carff.model import load_carff
from hashnerf.errors import UserError


def test_a_folder_without_a_run_is_a_sentence(tmp_path):
    with pytest.raises(UserError, match="not a run folder"):
        load_carff(tmp_path)
