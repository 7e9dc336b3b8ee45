from aerial2ground.report_words import (
    COLOURS,
    DRIVERS,
    LOCATORS,
    PAPER_TABLE_1,
    PAPER_TABLE_2,
    PRIORS,
    paper_drive,
    paper_place,
    town_key,
)


def test_everything_that_is_drawn_has_a_colour_of_its_own_within_its_figure():
    for group in (DRIVERS, LOCATORS, PRIORS):
        assert len({COLOURS[name] for name in group}) == len(group)


def test_the_papers_tables_are_whole():
    assert [set(rows) for rows in PAPER_TABLE_1] == [set(LOCATORS)] * 3
    assert [set(rows) for rows in PAPER_TABLE_2] == [set(DRIVERS) - {"expert"}] * 3
    # Table I, scenario 2, Ours + IMU; Table II, trajectory 3, Ours + GV
    assert paper_place(town_key(1), "ours_imu") == (0.12, 1.59) and paper_drive(2, "ours_gv") == (0.12, 3.57, 1)


def test_beyond_the_papers_three_there_is_nothing():
    assert paper_place(town_key(3), "ours") is None and paper_drive(3, "ours") is None
    assert paper_drive(0, "expert") is None
