import io
import threading

import numpy as np
import pytest
from PIL import Image

from hashnerf.figure_style import new_figure, png_bytes, show_picture


def test_png_is_a_picture_and_the_same_every_time():
    def draw() -> bytes:
        figure = new_figure(2.0, 1.0)
        show_picture(figure.subplots(), np.full((4, 4, 3), 0.5), "title", frame="#ff0000", dashed=True)
        return png_bytes(figure)

    first = draw()
    assert Image.open(io.BytesIO(first)).size == (280, 140)
    assert first == draw()


def test_figures_can_be_drawn_in_threads():
    results: list[bytes] = []
    threads = [threading.Thread(target=lambda: results.append(png_bytes(new_figure(1.0, 1.0)))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 2 and results[0] == results[1]


def test_a_picture_of_the_wrong_range_is_refused():
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        show_picture(new_figure(1.0, 1.0).subplots(), np.full((2, 2, 3), 200.0))
