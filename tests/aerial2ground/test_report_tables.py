"""Tables as people read them."""

from aerial2ground.report_tables import (
    driving_tables,
    ground_tables,
    policy_tables,
    reconstruction_tables,
    spread,
    table_one,
    table_two,
)


def test_means_carry_their_spread():
    row = {"pos_m": 0.0312, "pos_m_spread": 0.004, "yaw_deg": 2.0}
    assert spread(row, "pos_m", "m") == "0.031 ± 0.004 m"
    assert spread(row, "yaw_deg", "deg") == "2.00 deg" and spread(row, "interventions") == "–"
    assert spread({"n": 1.5, "n_spread": 0.5}, "n", digits=1) == "1.5 ± 0.5"


def test_table_one_has_the_paper_beside_ours_up_to_its_three_towns():
    row = {"pos_m": 0.1, "yaw_deg": 2.0, "pos_m_median": 0.05, "yaw_deg_median": 1.0}
    (table,) = table_one({"table1": {"layout_0": {"ours_imu": row}, "layout_3": {"ours_imu": row}}})
    assert table.rows[0] == ("layout 0, Ours + IMU", "0.100 m", "0.11 m", "2.00 deg", "2.26 deg", "0.050 m", "1.00 deg")
    assert table.rows[1][2] == table.rows[1][4] == "–"


def test_table_two_has_the_paper_beside_ours_by_the_order_of_trajectories():
    row = {"pos_m": 0.02, "yaw_deg": 1.0, "interventions": 0.5, "most_interventions": 1, "runs": 2}
    (table,) = table_two({"table2": {"a": {"expert": row, "ours": row}, "b": {"ours_gv": row}}})
    assert table.rows[0][2] == "–", "the paper has no expert"
    assert table.rows[1] == ("a, Ours", "0.020 m", "0.36 m", "1.00 deg", "7.39 deg", "0.5", "5", "1", "2")
    assert table.rows[2][2] == "0.09 m" and all(len(row) == len(table.header) for row in table.rows)


def test_ground_table_shows_the_figures_that_were_measured():
    ground = {"main": {"psnr_db": 23.0, "ssim": None}, "psnr_db": {"none": 18.0}, "road_depth_rmse_m": {"none": 0.1}}
    (table,) = ground_tables({"ground": ground})
    assert table.header == ("field", "PSNR", "road depth RMSE up to 2 m")
    assert table.rows == (("this run", "23.0 dB", "–"), ("prior: none", "18.0 dB", "0.100 m"))


def test_tables_without_results_are_empty_or_dashes():
    for build in (ground_tables, table_one, table_two, policy_tables, driving_tables):
        assert build({}) == []
    (table,) = reconstruction_tables({})
    assert {row[1] for row in table.rows} == {"–"}


def test_poses_before_and_after_refinement():
    poses = {"told_m": 0.03, "told_deg": 2.0, "refined_m": 0.0042, "refined_deg": 0.21}
    assert reconstruction_tables({"poses": poses})[1].rows[1] == ("after refinement", "0.0042 m", "0.21 deg")


def test_policy_table_names_what_was_timed():
    (table,) = policy_tables({"policy": {"latency_ms_1thread": 0.62, "onnx_ms": None}})
    assert table.rows == (("PyTorch, median", "0.62 ms"),)
