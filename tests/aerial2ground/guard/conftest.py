"""A world around the guard's loop."""

import signal
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.aerial2ground.guard.place import Place
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


@pytest.fixture
def place(tmp_path, monkeypatch) -> "Iterator[Place]":
    """A place for the guard's process, left as it was found."""
    from aerial2ground.guard.guard_process import IGNORED, SIGNALS
    from tests.aerial2ground.guard.place import Place, closed

    before = {number: signal.getsignal(number) for number in (*SIGNALS, *IGNORED)}
    made = Place(tmp_path / "log", monkeypatch)
    yield made
    made.policy_socket = -1 if closed(made.policy_socket) else made.policy_socket
    made.close()
    assert {number: signal.getsignal(number) for number in before} == before
