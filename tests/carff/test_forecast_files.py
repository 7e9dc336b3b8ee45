"""Reading the picture to forecast from: any size of the right shape, one sentence for the others."""

import numpy as np
import pytest
import torch
from PIL import Image

from carff.forecast_files import read_picture
from hashnerf.errors import UserError


def test_a_larger_picture_is_averaged_down(tmp_path):
    board = np.zeros((8, 8, 3), np.uint8)
    board[::2, ::2] = 200
    Image.fromarray(board).save(tmp_path / "a.png")
    # Every 2 x 2 block holds one 200 and three zeros.
    assert torch.equal(read_picture(tmp_path / "a.png", 4, 4), torch.full((4, 4, 3), 50, dtype=torch.uint8))


def test_another_shape_is_refused_with_the_ratio(tmp_path):
    Image.fromarray(np.zeros((8, 16, 3), np.uint8)).save(tmp_path / "wide.png")
    with pytest.raises(UserError, match="crop it to the aspect ratio 4 : 4"):
        read_picture(tmp_path / "wide.png", 4, 4)


def test_no_picture_at_all(tmp_path):
    (tmp_path / "text.png").write_text("not a picture")
    with pytest.raises(UserError, match=r"text.png"):
        read_picture(tmp_path / "text.png", 4, 4)


def test_a_smaller_picture_is_enlarged_and_said_so(tmp_path, capsys):
    Image.fromarray(np.full((2, 2, 3), 90, np.uint8)).save(tmp_path / "small.png")
    assert torch.equal(read_picture(tmp_path / "small.png", 4, 4), torch.full((4, 4, 3), 90, dtype=torch.uint8))
    assert "2 pixels wide, enlarged to 4" in capsys.readouterr().err
