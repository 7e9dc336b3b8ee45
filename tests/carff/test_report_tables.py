from carff.planning_metrics import Episode, closed_loop_results
from carff.report_tables import (
    closed_loop_tables,
    data_tables,
    drive_tables,
    forecast_tables,
    pcvae_tables,
    plan_tables,
    scene_tables,
    share,
)


def test_shares_carry_their_interval():
    assert share(0.973, [0.951, 0.986]) == "97.3 % [95.1, 98.6]"
    assert share(0.973) == "97.3 %" and share(None, [0.1, 0.2]) == "–"


def test_tables_without_results_are_empty_or_dashes():
    for build in (data_tables, pcvae_tables, forecast_tables, plan_tables, closed_loop_tables):
        assert not any(table.rows for table in build({}))
    assert scene_tables({})[0].rows[0][1:] == ("–", "–")


def test_scene_table_sets_trained_beside_held_out():
    nerf = {
        "psnr_matched_db": 28.1,
        "psnr_matched_heldout_db": 27.0,
        "changed_px_lead_db": 7.5,
        "state_identified_count": 6,
        "states": 6,
        "state_identified_heldout": 0.5,
    }
    rows = scene_tables({"nerf": nerf})[0].rows
    assert ("against its own state", "28.1 dB", "27.0 dB") in rows
    assert ("changed pixels, lead over the others", "7.5 dB", "–") in rows
    assert rows[-1] == ("renderings nearest to their own state", "6 of 6", "50.0 %")


def test_plan_table_names_rule_and_samples():
    row = {"hazard_success": 1.0, "hazard_count": [30, 30], "hazard_interval": [0.9, 1.0], "hazard_worst_image": 1.0}
    rows = plan_tables({"plan": {"always_stop": row, "risk": {"n10": row, "n35_change": 0.0}}})[0].rows
    assert rows[0][:4] == ("always stop (under-confident)", "100.0 % [90.0, 100.0]", "30 of 30", "100 %")
    assert rows[1][0] == "risk rule, n = 10" and rows[1][4:] == ("–", "–", "–")


def test_closed_loop_table_of_a_policy_that_never_crosses():
    results = closed_loop_results([Episode("always_stop", 0, False, False, True, True, None, 9)])
    row = closed_loop_tables({"closed_loop": results})[0].rows[0]
    assert row[:3] == ("always stop (under-confident)", "1", "0") and row[-1] == "–"


def test_the_approach_has_a_table_of_its_own():
    along = {"pictures": 4, "success": 0.75, "interval": [0.3, 0.95]}
    none = {"pictures": 0, "success": None, "interval": None}
    (table,) = drive_tables({"approach": {"hidden": along, "shown": none, "clear": none}})
    assert table.rows[0] == ("hides a hazard: waits", "4", "75.0 % [30.0, 95.0]")
    assert [row[1:] for row in table.rows[1:]] == [("0", "–")] * 2
    assert drive_tables({}) == []


def test_forecast_table_names_branches_where_the_data_does():
    calibration = {
        "by_visibility": {
            "none": {"views": 4, "ece": 0.02, "mae": 0.03},
            "full": {"views": 0, "ece": None, "mae": None},
        },
        "ambiguous": {"views": 4, "mean_probability": [0.52, 0.48], "mean_frequency": [0.5, 0.5]},
    }
    results = {"forecast": {"calibration": calibration}, "data": {"branches": ["absent", "present"]}}
    classes, branches = forecast_tables(results)
    assert classes.rows == (("none", "4", "0.020", "0.030"), ("full", "0", "–", "–"))
    assert branches.rows == (("absent", "0.52", "0.50"), ("present", "0.48", "0.50"))
    assert forecast_tables({"forecast": {"calibration": calibration}})[1].rows[0][0] == "0"


def test_what_is_used_stands_beside_what_is_needed():
    use = {"there": 2, "used": 1.3412, "needed": 1.4142, "needed_most": 2}
    (table,) = forecast_tables({"forecast": {"components": use}})
    assert [row[1] for row in table.rows] == ["2", "1.34", "1.41", "2"]
