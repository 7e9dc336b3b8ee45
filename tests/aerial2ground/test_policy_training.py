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


def test_one_picture_is_too_few():
    with pytest.raises(UserError, match="1 training pictures are too few"):
        train_network(TaskConfig(), *bright_side(1, 0), "l1", 0)


@pytest.mark.parametrize(
    "build, key",
    [
        (lambda: TaskConfig(epochs=0), "task.epochs"),
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
