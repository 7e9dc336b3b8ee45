import numpy as np

from aerial2ground.ablation_charts import prior_views, priors_chart, split_views
from hashnerf.figure_style import png_bytes


def test_a_panel_for_every_figure_that_was_measured():
    ground = {"main": {"psnr_db": 1.0}, "psnr_db": {"none": 18.0, "full": 21.0}, "ssim": {"none": None}}
    figure = priors_chart(ground)
    assert [axes.get_title(loc="left") for axes in figure.axes if axes.axison] == ["PSNR (dB)"]
    assert [text.get_text() for text in figure.axes[0].texts] == ["18.0", "21.0"]
    assert png_bytes(figure).startswith(b"\x89PNG")


def test_a_sheet_of_views_falls_into_its_pairs():
    # two lines of three pairs, 4 x 5 px: truth in even, view in odd rows of pictures
    sheet = np.zeros((2 * 2 * 4, 3 * 5, 3), dtype=np.uint8)
    for place in range(6):
        down, across = divmod(place, 3)
        for half in range(2):
            top = (2 * down + half) * 4
            sheet[top : top + 4, across * 5 : across * 5 + 5] = 10 * place + half
    pairs = split_views(sheet, 4, 5)
    assert [(int(true.mean()), int(seen.mean())) for true, seen in pairs] == [(10 * k, 10 * k + 1) for k in range(6)]
    assert split_views(sheet, 5, 5) is None and split_views(sheet, 40, 50) is None


def test_the_same_places_line_by_line():
    truth = [np.full((4, 6, 3), 50 * k, dtype=np.uint8) for k in range(5)]
    figure = prior_views(truth, {"full": truth, "none": truth})
    assert len(figure.axes) == 3 * 4
    assert [axes.get_ylabel() for axes in figure.axes[::4]] == ["truth", "none", "+ free space"]
    assert png_bytes(figure).startswith(b"\x89PNG")
