"""What a report tells, section by section: the figures with captions that say what to look for, and the tables beside
them.
"""

from aerial2ground.report_tables import driving_tables, ground_tables, reconstruction_tables, table_one
from hashnerf.report_page import Panel, Section
from hashnerf.stage_costs import cost_tables

SECTIONS = (
    Section(
        "survey",
        "Survey: what the drone saw",
        "Pictures from above, the poses that motion capture told, and a map of the roads: all that is learned from.",
        (
            Panel("survey", "Pictures of the survey", "Straight down and oblique, through a real lens.", "nerf"),
            Panel(
                "aerial_view",
                "A place the field never saw",
                "Held-out drone pictures (above) and the field from their poses (below). Look for edges that are "
                "doubled or soft: there the poses were wrong.",
                "nerf.aerial_heldout_psnr_db",
            ),
        ),
        reconstruction_tables,
    ),
    Section(
        "ground",
        "Ground: the car's view of a field made from above",
        "No picture was ever taken at these places. Where houses and trees hide the road from the drone, only the road "
        "prior says what lies there.",
        (
            Panel(
                "ground_views",
                "The truth and the field",
                "In every pair of lines: the town as it is (above) and the field (below).",
                "ground.main",
            ),
            Panel(
                "prior_views",
                "With and without road prior",
                "The same places with more and more of the prior: its colour, its distance from above, free space "
                "above it. Look at the road near the car, and for haze in front of it.",
                "ground.psnr_db",
            ),
            Panel(
                "priors",
                "What each part of the prior adds",
                "Each step to the right adds one part. Trainings differ in nothing else; one seed each.",
                "ground.psnr_db",
            ),
        ),
        ground_tables,
    ),
    Section(
        "drive",
        "Drive: steering by pictures",
        "Networks that steer by the camera alone, in the town as it is on the day: other light, moved objects, noise, "
        "motion blur. Starts are disturbed. Who leaves half a lane or touches something is put back: an intervention.",
        (
            Panel(
                "driven_paths",
                "Driven paths",
                "Every drive over the roads. Crosses are interventions; the dashes are the path to follow.",
                "table2",
            ),
            Panel(
                "path_errors",
                "Errors along the path",
                "Root mean square over all drives and laps at each place. The grey line is where somebody intervenes. "
                "Look for peaks that methods share: there the pictures mislead.",
                "table2",
            ),
            Panel(
                "drive_errors",
                "Table II as a picture",
                "Dots are means over drives with their standard deviation, hollow diamonds the paper's figures of its "
                "own town and car.",
                "table2",
            ),
        ),
        driving_tables,
    ),
    Section(
        "locate",
        "Locate: where is the car?",
        "A network tells position and yaw from one picture; fused with the inertial sensor it becomes a track.",
        (
            Panel(
                "located_paths",
                "Estimates on the map",
                "Dots are estimates, thin lines lead to where the car truly was. Long lines to another part of the "
                "town are places that look alike.",
                "table1.layout_0",
            ),
            Panel(
                "located_errors",
                "How often an error is how large",
                "One column an arrangement of the houses. A curve further to the left is better; a long tail to the "
                "right is what fusion should cut off. Dots are medians.",
                "table1",
            ),
            Panel(
                "place_errors",
                "Table I as a picture",
                "Dots are means over networks with their standard deviation, hollow diamonds the paper's figures of "
                "its own town and camera.",
                "table1",
            ),
        ),
        table_one,
    ),
    Section(
        "cost",
        "Cost",
        "Wall-clock time and peak memory on the machine named above. Stages that ran side by side are shown with their "
        "own time; the total counts the time of their phase once.",
        (
            Panel(
                "stages",
                "Time and memory of every stage",
                "In the order in which they ended; what ran side by side follows its phase.",
                "seconds_total",
            ),
        ),
        cost_tables,
    ),
)
