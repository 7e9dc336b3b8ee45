from matplotlib.figure import Figure

from hashnerf.stage_costs import cost_tables, ordered_stages, peak_memory_mb, stages_chart


def _texts(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_stages_say_what_was_not_measured():
    stages = [
        {"name": "PC-VAE", "seconds": 61.0, "peak_memory_mb": 1234.0},
        {"name": "plan", "seconds": 2.0, "peak_memory_mb": None},
    ]
    assert [text.strip() for text in _texts(stages_chart(stages))] == ["61 s", "2 s", "1,234 MB", "not measured"]


def test_the_table_ends_with_the_total_and_what_it_covers():
    assert cost_tables({})[0].rows == (("total", "–", "–"),)
    partial = {"seconds_cover": "trainings and evaluation only", "seconds_total": 3.0}
    assert cost_tables(partial)[0].rows[-1][0] == "trainings and evaluation only"


def test_this_process_takes_memory():
    assert 1 < peak_memory_mb() < 1e6


def test_members_follow_their_phase_and_are_marked():
    cost = {"seconds": 1.0, "peak_memory_mb": 2.0}
    timed = {"a": cost | {"within": "both"}, "data": cost, "b": cost | {"within": "both"}, "both": cost}
    stages = ordered_stages(timed)
    assert [stage["name"] for stage in stages] == ["data", "both", "a", "b"]
    rows = cost_tables({"stages": stages, "seconds_total": 2.0})[0].rows
    assert [row[0] for row in rows] == ["data", "both", "· a", "· b", "total"]
    assert [label.get_text() for label in stages_chart(stages).axes[0].get_yticklabels()][2] == "· a"


def test_a_member_of_a_phase_that_was_never_noted_is_not_lost():
    assert [stage["name"] for stage in ordered_stages({"a": {"seconds": 1.0, "within": "gone"}})] == ["a"]
