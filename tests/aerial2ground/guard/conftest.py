"""A world around the guard's loop."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.aerial2ground.guard.world import World


@pytest.fixture
def make_world(tmp_path, monkeypatch) -> "Iterator[Callable[..., World]]":
    """Makes worlds, and closes them."""
    # not at the top: a guard that cannot be imported shall fail its tests, and not keep pytest from running
    from tests.aerial2ground.guard.world import World

    worlds = []

    def make(**changed) -> World:
        worlds.append(World(tmp_path / str(len(worlds)), monkeypatch, **changed))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()


@pytest.fixture
def world(make_world) -> "World":
    """A world with a port, a car and a policy."""
    return make_world()
