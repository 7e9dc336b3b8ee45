"""The sections of the report: every panel once, each depending on a result that there is."""

from aerial2ground.report_sections import SECTIONS
from aerial2ground.targets import required_keys


def test_panel_names_and_anchors_are_unique():
    names = [panel.name for section in SECTIONS for panel in section.panels]
    assert len(set(names)) == len(names)
    assert len({section.anchor for section in SECTIONS}) == len(SECTIONS)


def test_panels_depend_on_results_that_exist():
    roots = {key.split(".")[0] for key in required_keys(["a"], ["layout_0"])}
    assert {panel.depends.split(".")[0] for section in SECTIONS for panel in section.panels} <= roots


def test_every_figure_says_what_to_look_for():
    assert all(len(panel.caption) > 20 and panel.title for section in SECTIONS for panel in section.panels)
