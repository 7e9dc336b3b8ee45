"""What a report tells, section by section: the figures with captions that say what to look for, and the tables beside
them.
"""

from carff.report_tables import data_tables, drive_tables, forecast_tables, pcvae_tables, plan_tables, scene_tables
from hashnerf.report_page import Panel, Section
from hashnerf.stage_costs import cost_tables

SECTIONS = (
    Section(
        "data",
        "The data",
        "Each state of the world (a branch at a step) is seen by the same cameras. What a camera shows of the actor "
        "decides what can be known from its picture.",
        (
            Panel(
                "contact_sheet",
                "States and cameras",
                "One row a state, one column a camera. Frames say how much of the actor the view shows, the number in "
                "its corner is the visible share of its pixels. Look for columns whose pictures agree between "
                "branches: no method can tell those states apart, and a good one says so.",
                "data",
            ),
        ),
        data_tables,
    ),
    Section(
        "belief",
        "Belief: the PC-VAE",
        "An image becomes a Gaussian over latents that stands for the whole scene, whichever camera took it.",
        (
            Panel(
                "reconstructions",
                "Reconstructions",
                "Left: the image that is encoded. Middle: the ground truth of every state at that camera, the encoded "
                "state framed. Right: the belief decoded at other cameras, under the truth. An occluded input should "
                "decode to a blend or to one of the states it fits, never to a state it rules out.",
                "pcvae.psnr_train_db",
            ),
            Panel(
                "psnr_train",
                "Training curve",
                "PSNR of the mean squared error of 64 training views, decoded at other cameras. Views that hide the "
                "state keep it below the mean PSNR of the table.",
                "pcvae.psnr_train_db",
                half=True,
            ),
            Panel(
                "tsne",
                "Latents in the plane",
                "Views of one state from many cameras should lie together. Crosses, whose pictures fit several "
                "states, belong between or on top of the clusters they fit.",
                "pcvae.svm_all",
                half=True,
            ),
        ),
        pcvae_tables,
    ),
    Section(
        "scenes",
        "Scenes: the radiance field",
        "Every latent is a scene that can be looked at from anywhere and probed for what stands where.",
        (
            Panel(
                "psnr_matrix",
                "Bird's-eye camera trained on",
                "Bold: PSNR against the state's own ground truth. Elsewhere: how much worse the other states fit. "
                "Every row should lose clearly everywhere but at its own state; states with the same picture count as "
                "one.",
                "nerf.psnr_matched_db",
                half=True,
            ),
            Panel(
                "psnr_matrix_heldout",
                "Bird's-eye camera held out",
                "The same with a field that never saw this camera: the honest figure for a new viewpoint.",
                "nerf.psnr_matched_heldout_db",
                half=True,
            ),
            Panel(
                "probe_confusion",
                "Answers of the density probe",
                "Each row is a true state. The probe may answer unknown; answering a wrong state is worse.",
                "probe.accuracy",
                half=True,
            ),
        ),
        scene_tables,
    ),
    Section(
        "forecast",
        "Forecast: what may come next",
        "From one image the mixture network forecasts the next belief. Samples of it are rendered and probed.",
        (
            Panel(
                "futures_clear",
                "A clear view",
                "An unseen image that decides the future: every sample should show the one true next state.",
                "forecast.branch_ece",
            ),
            Panel(
                "futures_occluded",
                "An occluded view",
                "An unseen image that leaves the future open: the samples should show every plausible next state, "
                "about as often as it really follows. Frames carry the colour of the state the probe found; dashed is "
                "unknown.",
                "forecast.branch_ece",
            ),
            Panel(
                "accuracy_recall",
                "Accuracy and recall of forecasts",
                "Accuracy is the share of right samples and does not depend on n; that ALL n are right becomes rarer "
                "with n, which is what stops a controller that trusts every sample. Recall is the share of plausible "
                "states found. Bands are 95 % bootstrap intervals over images, dashes what independent draws would "
                "give.",
                "forecast.branch_ece",
            ),
            Panel(
                "accuracy_recall_latents",
                "Accuracy and recall of encoded beliefs",
                "The same for samples of the encoder's own belief about the present.",
                "forecast.branch_ece",
            ),
            Panel(
                "calibration",
                "Calibration of branch probabilities",
                "Dots on the diagonal are honest probabilities; the area is the share of views. The truth of a view "
                "is the frequency of each branch among the states that give exactly its picture, one half where two "
                "branches look the same.",
                "forecast.branch_ece",
            ),
        ),
        forecast_tables,
    ),
    Section(
        "plan",
        "Plan: wait or go",
        "One image, n sampled futures, one decision. The paper rule goes only if no sample shows a hazard; the risk "
        "rule weighs the cost of a collision against the cost of waiting.",
        (
            Panel(
                "planning",
                "Open-loop decisions",
                "Both columns must be right at once: always waiting and always going are each perfect in one. Bars "
                "are 95 % Wilson intervals over all trials, hollow diamonds the rates that the paper prints for its "
                "own data.",
                "plan",
            ),
        ),
        plan_tables,
    ),
    Section(
        "drive",
        "Drive: the closed loop",
        "Random start positions, speeds and seeds. Each policy decides again and again from what its camera shows.",
        (
            Panel(
                "closed_loop",
                "Policies side by side",
                "Left must be empty, the middle close to the all-seeing oracle, the right as short as safety allows.",
                "closed_loop",
            ),
            Panel(
                "approach",
                "Single pictures along the approach",
                "What is expected at places where no camera of the data stands, the actors standing where the data has "
                "them. A hidden hazard should be about as probable as it is, all the way to where it comes into view; "
                "crosses mark decisions that were wrong.",
                "closed_loop",
            ),
        ),
        drive_tables,
    ),
    Section(
        "cost",
        "Cost",
        "Wall-clock time and peak memory on the machine named above.",
        (Panel("stages", "Time and memory of every stage", "In the order the stages ran.", "seconds_total"),),
        cost_tables,
    ),
)
