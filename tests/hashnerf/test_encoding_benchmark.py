"""The plain encoding is the same function as ours, and the table's ratios are worked by hand."""

import pytest
import torch

from hashnerf.encoding_benchmark import EncodingBenchmark, encoding_table, plain_encoding, time_encodings
from hashnerf.errors import UserError
from hashnerf.hash_grid import HashGrid


def test_the_plain_encoding_gives_the_same_features_and_gradients():
    box = torch.tensor([[-1.0, 0.0, 0.5], [1.0, 3.0, 1.5]])
    grid = HashGrid(box, 5, 2, 9, 4, 60)
    torch.nn.init.uniform_(grid.table, -1, 1)
    assert {level.hashed for level in grid.plan} == {False, True}
    positions = box[0] + torch.rand(500, 3) * (box[1] - box[0])
    pull = torch.randn(500, grid.out_features)
    ours, plain = grid(positions), plain_encoding(grid, positions)
    assert torch.allclose(ours, plain, atol=1e-5)
    (of_ours,) = torch.autograd.grad(ours, grid.table, pull)
    (of_plain,) = torch.autograd.grad(plain, grid.table, pull)
    assert torch.allclose(of_ours, of_plain, atol=1e-4)
    assert of_plain.abs().max() > 1


def test_every_way_is_timed():
    small = EncodingBenchmark(points=64, levels=2, log2_table_size=8, finest_resolution=32, turns=1)
    seconds = time_encodings(small)
    assert set(seconds) == {f"{way} {part}" for way in ("plain", "eager", "compiled") for part in ("forward", "both")}
    assert all(value > 0 for value in seconds.values())


def test_ratios_by_hand():
    seconds = {"plain forward": 0.4, "plain both": 1.2, "eager forward": 0.1, "eager both": 0.1}
    table = encoding_table(seconds)
    assert table.rows == (
        ("plain", "400.0 ms", "1200.0 ms", "1.0", "1.0"),
        ("eager", "100.0 ms", "100.0 ms", "4.0", "12.0"),
    )


@pytest.mark.parametrize(("key", "value"), [("points", 0), ("levels", 0), ("turns", 0), ("device", "tpu")])
def test_impossible_settings_name_the_key(key, value):
    with pytest.raises(UserError, match=f"{key} is {value}"):
        EncodingBenchmark(**{key: value})
