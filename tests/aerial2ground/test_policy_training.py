"""Training of the networks: they learn, repeat with the seed, and see changed pictures."""

import pytest
import torch

from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.policy_training import AugmentationConfig, TaskConfig, as_input, augmented, train_network
from hashnerf.errors import UserError


def bright_side(count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Pictures with a white bar, and where it is."""
    generator = torch.Generator().manual_seed(seed)
    place = torch.randint(2, 30, (count,), generator=generator)
    pictures = torch.full((count, 24, 32, 3), 60, dtype=torch.uint8)
    for picture, column in zip(pictures, place.tolist()):
        picture[:, column - 1 : column + 2] = 220
    return pictures, (place.float() / 16 - 1)[:, None]


@pytest.mark.parametrize("loss", ["l1", "l2"])
def test_a_network_learns_where_a_bar_is(loss):
    config = TaskConfig(epochs=30, batch_size=32, augmentation=AugmentationConfig(shadow=0.1))
    network = train_network(config, *bright_side(256, 0), loss, seed=0)
    pictures, place = bright_side(64, 1)
    with torch.no_grad():
        error = (network(as_input(pictures)) - place).abs().mean()
    assert float(error) < 0.12


def test_k26_training_repeats_with_the_seed(numeric_row):
    config = TaskConfig(epochs=2, batch_size=16)
    one, two, other = (train_network(config, *bright_side(32, 0), "l1", seed) for seed in (0, 0, 1))
    different = sum(not torch.equal(a, b) for a, b in zip(one.state_dict().values(), two.state_dict().values()))
    numeric_row("K26", "a policy trained twice from one seed: tensors that differ", different)
    assert any(not torch.equal(a, b) for a, b in zip(one.state_dict().values(), other.state_dict().values()))


def test_decay_takes_its_share_of_every_weight():
    pictures = torch.zeros(16, 24, 32, 3, dtype=torch.uint8)

    def size(decay):
        # one step: what is learned is the same, what is taken is lr * decay of the weight before
        config = TaskConfig(epochs=1, batch_size=16, lr=0.01, weight_decay=decay)
        return train_network(config, pictures, torch.zeros(16, 1), "l1", seed=0).head[1].weight.detach()

    torch.manual_seed(0)
    before = PictureNetwork(NetworkConfig(), 24, 32, 1).head[1].weight.detach()
    assert torch.allclose(size(0.0) - size(20.0), 0.2 * before, atol=1e-5)


def test_training_that_broke_down_is_not_taken_for_trained():
    with pytest.raises(UserError, match=r"broke down.*lower task.lr"):
        train_network(TaskConfig(epochs=2, batch_size=16, lr=1e30), *bright_side(32, 0), "l1", seed=0)


def test_n133_one_bad_target_does_not_spoil_the_network(numeric_row):
    pictures, place = bright_side(64, 0)
    config = TaskConfig(epochs=3, batch_size=16)
    place[5] = torch.nan  # in one batch of four, another one every time
    network = train_network(config, pictures, place, "l1", seed=1)
    bad = sum(int((~one.isfinite()).sum()) for one in network.state_dict().values())
    numeric_row("N133", "a target that is NaN, one batch of four: weights not finite", bad)
    with pytest.raises(UserError, match=r"loss.* not finite 11 times in a row") as refused:
        train_network(config, pictures, torch.full_like(place, torch.nan), "l1", seed=0)
    numeric_row("N133", "all targets NaN: went on", refused is None)


@pytest.mark.parametrize("count", [2, 3, 17, 33])
def test_n138_no_batch_is_too_small_for_normalisation(numeric_row, count):
    # 16 x 16 pixels are 1 x 1 after the last convolution: a batch of one would have one value a channel
    pictures = torch.randint(256, (count, 16, 16, 3), dtype=torch.uint8)
    network = train_network(TaskConfig(epochs=2, batch_size=16), pictures, torch.zeros(count, 1), "l1", seed=0)
    assert not network.training
    statistics = [one for name, one in network.state_dict().items() if "running" in name]
    bad = sum(int((~one.isfinite()).sum()) for one in statistics)
    numeric_row("N138", f"{count} pictures in batches of 16: running statistics not finite", bad)
    with torch.no_grad():
        together = network(as_input(pictures))
        alone = torch.cat([network(as_input(one[None])) for one in pictures])
    numeric_row("N138", f"{count} pictures, each alone and all at once", float((together - alone).abs().max()), 1e-6)


def test_n139_the_papers_step_does_not_diverge(numeric_row):
    # three convolutions instead of five: what may diverge is the step, and two thousand of them take their time
    shallow, plain = NetworkConfig(layers=3), AugmentationConfig(*[0.0] * 6)
    config = TaskConfig(shallow, plain, epochs=20, batch_size=8)
    broken = 0
    for seed in range(20):
        pictures = torch.randint(256, (40, 8, 8, 3), dtype=torch.uint8)
        network = train_network(config, pictures, torch.randn(40, 4), "l2", seed)
        broken += not all(bool(one.isfinite().all()) for one in network.state_dict().values())
    numeric_row("N139", "Adam at 0.01, 20 seeds, 100 steps of noise: networks not finite", broken)


def test_augmentation_keeps_the_range_and_the_depth():
    pictures = torch.rand(16, 4, 20, 24, generator=torch.Generator().manual_seed(0))
    changed = augmented(pictures, AugmentationConfig(row_jitter=0.0), torch.Generator().manual_seed(1))
    assert (changed >= 0).all() and (changed <= 1).all()
    assert torch.equal(changed[:, 3:], pictures[:, 3:]) and not torch.allclose(changed[:, :3], pictures[:, :3])
    off = AugmentationConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert torch.allclose(augmented(pictures, off, torch.Generator()), pictures, atol=1e-4)


def test_some_rows_show_what_the_row_above_shows_in_all_channels_and_in_the_sky():
    height = 27
    rows = torch.arange(height).float()[None, None, :, None]
    pictures = (rows / height).expand(400, 4, height, 5).contiguous()
    only = AugmentationConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.2, sky=False)
    changed = augmented(pictures, only, torch.Generator().manual_seed(0))
    assert torch.allclose(changed[:, :3], changed[:, 3:].expand(400, 3, height, 5), atol=1e-4), "colour and depth alike"
    moved = pictures - changed
    assert set((moved[:, 0, 1:] * height).round().unique().tolist()) == {0.0, 1.0} and not moved[:, 3, 0].any()
    assert float((moved[:, 3, 1:, 0] > 0.01).float().mean()) == pytest.approx(0.2, abs=0.02)
    # the sky's lower edge is where it went: no row below it gets another sky, none of it keeps the old one
    sky = torch.zeros(400, height, 5, dtype=torch.bool)
    sky[:, :10] = True
    seen = augmented(pictures, AugmentationConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.2), torch.Generator().manual_seed(0), sky)
    ground = changed[:, 3:] > 9.5 / height
    assert torch.equal(torch.where(ground, seen[:, :3], 0.0), torch.where(ground, changed[:, :3], 0.0))


def test_n138_one_picture_is_too_few():
    with pytest.raises(UserError, match="1 training pictures are too few"):
        train_network(TaskConfig(), *bright_side(1, 0), "l1", 0)


@pytest.mark.parametrize(
    "build, key",
    [
        (lambda: TaskConfig(epochs=0), "task.epochs"),
        (lambda: TaskConfig(batch_size=1), "task.batch_size is 1; give at least 2"),
        (lambda: TaskConfig(lr=0.0), "task.lr"),
        (lambda: TaskConfig(weight_decay=-0.1), "task.weight_decay"),
        (lambda: TaskConfig(weight_decay=float("nan")), "task.weight_decay"),
        (lambda: TaskConfig(lr=0.01, weight_decay=100.0), "task.weight_decay"),
        (lambda: AugmentationConfig(noise=1.0), "augmentation.noise"),
    ],
)
def test_bad_settings_are_named(build, key):
    with pytest.raises(UserError, match=key):
        build()


def test_a_sky_changes_where_nothing_is_and_nowhere_else():
    plain = AugmentationConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    pictures = torch.full((50, 4, 6, 8), 0.25)
    sky = torch.zeros(50, 6, 8, dtype=torch.bool)
    sky[:, :3] = True
    changed = augmented(pictures, plain, torch.Generator().manual_seed(0), sky)
    assert (changed[:, :, 3:] == 0.25).all() and (changed[:, 3] == 0.25).all(), "the ground, and depth"
    skies = changed[:, :3, :3]
    assert (skies >= 0).all() and (skies <= 1).all()
    assert (skies[:, 2] >= skies[:, 0] - 1e-6).all(), "grey to blue"
    assert float(skies[:, 0].std()) > 0.1 and (skies[..., 0] == skies[..., 7]).all(), "one colour a row"
    without = augmented(pictures, AugmentationConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, sky=False), torch.Generator(), sky)
    assert (without == 0.25).all()
