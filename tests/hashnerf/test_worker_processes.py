"""Work in several processes gives what one gives, in order, with one thread each."""

import os

import pytest
import torch

from hashnerf.errors import UserError
from hashnerf.worker_processes import map_in_processes


def squares():
    return lambda number: (number**2, os.getpid())


def threads():
    return lambda item: torch.get_num_threads()


def failing():
    def work(number: int) -> int:
        if number == 3:
            raise ValueError("number 3")
        return number

    return work


@pytest.mark.parametrize("workers, processes", [(1, 1), (2, 2)])
def test_results_come_in_order_from_as_many_processes(workers, processes):
    results = list(map_in_processes(squares, range(8), workers))
    assert [square for square, _ in results] == [number**2 for number in range(8)]
    assert len({pid for _, pid in results}) <= processes
    assert (os.getpid() in {pid for _, pid in results}) == (workers == 1)


def test_a_process_has_one_thread():
    assert list(map_in_processes(threads, range(2), 2)) == [1, 1]


def test_no_items_need_nothing():
    def never():
        raise AssertionError("made for nothing")

    assert list(map_in_processes(never, [], 2)) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_comes_through(workers):
    with pytest.raises(ValueError, match="number 3"):
        list(map_in_processes(failing, range(8), workers))


def unprepared():
    raise UserError("runs/x: no field here; run scripts/train_road_nerf.py first")


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_missing_is_said_in_its_own_words(workers):
    with pytest.raises(UserError, match="no field here"):
        list(map_in_processes(unprepared, range(4), workers))
