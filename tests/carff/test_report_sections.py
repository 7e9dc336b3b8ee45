"""The sections of the report: every panel once, every key a figure depends on is one that results have."""

from carff.report import REQUIRED_KEYS
from carff.report_sections import SECTIONS

OPTIONAL_ROOTS = {"data", "stages", "plan", "closed_loop"}


def test_panel_names_and_anchors_are_unique():
    names = [panel.name for section in SECTIONS for panel in section.panels]
    anchors = [section.anchor for section in SECTIONS]
    assert len(set(names)) == len(names)
    assert len(set(anchors)) == len(anchors)


def test_panels_depend_on_results_that_exist():
    roots = {key.split(".")[0] for key in REQUIRED_KEYS} | OPTIONAL_ROOTS
    assert {panel.depends.split(".")[0] for section in SECTIONS for panel in section.panels} <= roots


def test_every_figure_says_what_to_look_for():
    assert all(len(panel.caption) > 20 and panel.title for section in SECTIONS for panel in section.panels)
