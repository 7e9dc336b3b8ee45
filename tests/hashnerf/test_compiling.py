"""Optional compilation: off means eager, and a compiler that fails means eager with one sentence."""

import logging

import pytest
import torch

from hashnerf import compiling


def double(x: torch.Tensor) -> torch.Tensor:
    return 2 * x


def triple(x: torch.Tensor) -> torch.Tensor:
    return 3 * x


@pytest.fixture
def no_compiler(monkeypatch):
    """A torch whose compiler always fails, and a memory without earlier answers."""

    def broken(*args, **kwargs):
        raise RuntimeError("no C++ compiler\nand a long story")

    compiling._compiler_works.cache_clear()
    monkeypatch.setattr(torch, "compile", broken)
    yield
    compiling._compiler_works.cache_clear()


def test_eager_when_not_asked():
    assert compiling.compiled_or_eager(double, triple, compile=False) is triple


def test_eager_with_one_sentence_when_the_compiler_fails(no_compiler, caplog):
    with caplog.at_level(logging.WARNING):
        assert compiling.compiled_or_eager(double, triple, compile=True) is triple
        assert compiling.compiled_or_eager(double, triple, compile=True) is triple
    assert [record.getMessage() for record in caplog.records] == [
        "torch.compile does not work here, running without it: no C++ compiler"
    ]
