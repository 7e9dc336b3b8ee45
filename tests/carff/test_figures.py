import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from carff.figures import Futures, ReconstructionRow, contact_sheet, futures_strip, reconstruction_grid
from carff.state_style import ABSENT_COLOUR, VISIBILITY_COLOURS, state_style
from hashnerf.figure_style import png_bytes

PNG = b"\x89PNG"


def _states(count: int, branches: int) -> list[tuple[int, int]]:
    return [(branch, step) for branch in range(branches) for step in range(count // branches)]


def _pictures(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (*shape, 6, 8, 3)).astype(np.uint8)


def _frame(axes) -> str:
    return to_hex(axes.spines["left"].get_edgecolor())


def _titles(figure: Figure) -> list[str]:
    return [axes.get_title() or axes.get_title(loc="left") for axes in figure.axes]


def _row(states: int, targets: int = 2) -> ReconstructionRow:
    names = tuple(f"camera {index}" for index in range(targets))
    return ReconstructionRow(
        _pictures(), states - 1, "a view", _pictures(states), _pictures(targets), _pictures(targets), names
    )


def _futures(states: int, true: int, samples: tuple[int, ...], views: int = 2) -> Futures:
    return Futures(
        image=_pictures(),
        title="a view",
        view_names=("bird's-eye", "ego")[:views],
        true_states=tuple(range(true)),
        true_probability=(1 / true,) * true,
        true_pictures=_pictures(true, views),
        sampled_states=samples,
        sampled_pictures=_pictures(len(samples), views),
        mixture_weights=(0.3, 0.7),
        state_probability=(*([1 / true] * true), *([0.0] * (states - true)), 0.0),
        draws=50,
    )


def test_contact_sheet_frames_every_view_by_its_visibility():
    visibility = np.array([[-1, -1], [0, 2]])
    share = np.array([[np.nan, np.nan], [0.0, 0.97]])
    sheet = contact_sheet(_pictures(2, 2), state_style([(0, 0), (1, 0)]), ["near", "far"], visibility, share)
    frames = [_frame(axes) for axes in sheet.axes]
    expected = [ABSENT_COLOUR, ABSENT_COLOUR, VISIBILITY_COLOURS[0], VISIBILITY_COLOURS[2]]
    assert frames == [colour.lower() for colour in expected]
    notes = [text.get_text() for axes in sheet.axes for text in axes.texts]
    assert notes == ["0 %", "97 %"]
    assert _titles(sheet)[:2] == ["near", "far"] and sheet.axes[2].get_ylabel() == "B t0"


def test_contact_sheet_of_data_that_knows_no_visibility_has_no_legend():
    sheet = contact_sheet(_pictures(1, 2), state_style([(0, 0)]), ["a", "b"])
    assert not sheet.legends and png_bytes(sheet).startswith(PNG)


@pytest.mark.parametrize(("count", "branches"), [(10, 1), (6, 2), (5, 1), (4, 2), (1, 1)])
def test_reconstruction_grid_for_any_number_of_states(count, branches):
    style = state_style(_states(count, branches))
    grid = reconstruction_grid([_row(count)], style)
    assert all(name in _titles(grid) for name in style.names)
    framed = [axes for axes in grid.axes if axes.spines["left"].get_visible() and axes.axison]
    # The input and its own state among the truths carry the same frame, nothing else does.
    assert [_frame(axes) for axes in framed] == [style.colours[count - 1]] * 2


def test_reconstruction_grid_prints_the_quality_of_every_decoded_picture():
    row = _row(2)
    exact = ReconstructionRow(row.encoded, 0, "exact", row.truths, row.targets, row.targets, row.target_names)
    off = np.clip(row.targets / 255.0, 0.0, 0.9) + 0.1
    shifted = ReconstructionRow(
        row.encoded, 0, "shifted", row.truths, off - 0.1, off, row.target_names
    )  # error 0.1 everywhere: 20 dB
    grid = reconstruction_grid([exact, shifted], state_style([(0, 0), (0, 1)]))
    titles = _titles(grid)
    assert titles.count("inf dB") == 0 and titles.count("identical") == 2 and titles.count("20.0 dB") == 2
    assert png_bytes(grid).startswith(PNG)


@pytest.mark.parametrize(("count", "branches", "true"), [(10, 1, 1), (6, 2, 2), (4, 4, 3)])
def test_futures_strip_frames_samples_by_their_state(count, branches, true):
    style = state_style(_states(count, branches))
    strip = futures_strip(_futures(count, true, (0, -1, count - 1)), style)
    titles = _titles(strip)
    assert f"sample 1\n{style.names[0]}" in titles and "sample 2\nunknown" in titles
    first, unknown, last = (
        strip.axes[titles.index(f"sample {i + 1}\n{style.name(s)}")] for i, s in enumerate((0, -1, count - 1))
    )
    assert (_frame(first), _frame(last)) == (style.colours[0], style.colours[-1])
    assert unknown.spines["left"].get_linestyle() != first.spines["left"].get_linestyle()


def test_futures_strip_shows_mixture_weights_from_the_largest_and_probabilities_of_all_states():
    strip = futures_strip(_futures(2, 2, (0, 1), views=1), state_style([(0, 0), (1, 0)]))
    weights, chances = strip.axes[-2:]
    assert [bar.get_height() for bar in weights.patches] == [0.7, 0.3]
    assert [bar.get_height() for bar in chances.patches] == [0.5, 0.5, 0.0]
    assert [label.get_text() for label in chances.get_xticklabels()] == ["A t0", "B t0", "unknown"]
    assert png_bytes(strip).startswith(PNG)
