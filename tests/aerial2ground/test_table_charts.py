from aerial2ground.table_charts import table_one_chart, table_two_chart
from hashnerf.figure_style import png_bytes

ROW = {"pos_m": 0.1, "pos_m_spread": 0.02, "yaw_deg": 2.0, "interventions": 0.5}


def test_table_two_has_a_line_a_method_and_the_paper_where_it_has_one():
    figure = table_two_chart(
        {"outer_loop": {"expert": ROW, "ours": ROW}, "b": {"ours": ROW}, "c": {}, "d": {"ours": ROW}}
    )
    assert len(figure.axes) == 3
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["outer loop: expert", "outer loop: Ours", "b: Ours", "d: Ours"]
    diamonds = [line.get_xdata()[0] for line in figure.axes[0].lines if line.get_marker() == "D"]
    assert diamonds == [0.36, 0.20], "Table II, Ours, trajectories 1 and 2; the paper has no fourth"
    assert png_bytes(figure).startswith(b"\x89PNG")


def test_table_one_draws_spreads_and_leaves_out_what_is_missing():
    figure = table_one_chart({"layout_0": {"ours": ROW, "ours_imu": {"pos_m": None, "yaw_deg": None}}})
    bars = [list(line.get_xdata()) for line in figure.axes[0].lines if line.get_linewidth() == 5]
    assert bars == [[0.08, 0.12000000000000001]]
    assert png_bytes(figure).startswith(b"\x89PNG")
