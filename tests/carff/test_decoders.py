"""The picture decoders: the coefficient loss equals the pixel loss, and the shapes of data that bite."""

import pytest
import torch

from carff.decoders import ComponentsDecoder, ConvDecoder, DecoderConfig, pose_code
from hashnerf.errors import UserError


def pictures_and_index(states: int = 4, cameras: int = 3, size: int = 8):
    generator = torch.Generator().manual_seed(0)
    pictures = torch.randint(256, (states * cameras, size, size, 3), generator=generator, dtype=torch.uint8)
    return pictures, torch.arange(states * cameras).reshape(states, cameras)


def components(states: int = 4, cameras: int = 3, size: int = 8, rank: int = 16) -> ComponentsDecoder:
    torch.manual_seed(0)
    decoder = ComponentsDecoder(DecoderConfig(components=rank, width=16, balance=0.0), 8, cameras, states, size, size)
    pictures, index = pictures_and_index(states, cameras, size)
    decoder.fit_basis(pictures, index)
    return decoder


def test_coefficient_loss_equals_the_loss_on_pixels():
    decoder = components()
    pictures, index = pictures_and_index()
    latents, state = torch.randn(5, 8), [0, 1, 2, 3, 1]
    errors = decoder.reconstruction_errors(latents, torch.eye(4)[state], torch.Generator())
    for row in range(5):
        pixel_errors = []
        for camera in range(3):
            own = decoder.coefficients(latents)[row, camera]
            flat = decoder.mean[camera] + own @ decoder.basis[camera].float()
            target = pictures[index[state[row], camera]].flatten().float() / 255
            pixel_errors.append((flat - target).square().mean())
        # Four states span three dimensions around their mean, so three components leave nothing out.
        assert torch.isclose(errors[row], torch.stack(pixel_errors).mean(), rtol=2e-3)


def test_the_basis_is_the_same_under_autocast():
    plain = components()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        cast = components()
    assert torch.equal(cast.basis, plain.basis) and torch.equal(cast.targets, plain.targets)


@pytest.mark.parametrize("kind", ["components", "conv"])
def test_the_error_to_the_mean_picture_is_the_expected_error_but_for_a_constant(kind):
    pictures, index = pictures_and_index()
    if kind == "components":
        decoder = components()
    else:
        torch.manual_seed(0)
        decoder = ConvDecoder(DecoderConfig(kind="conv", width=16, targets=1), 8, torch.eye(3), 8)
        decoder.fit_basis(pictures, index)
    chance = torch.tensor([[0.5, 0.0, 0.3, 0.2]])

    def errors(latents: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        return decoder.reconstruction_errors(latents, wanted, torch.Generator().manual_seed(5))  # one camera for all

    gaps = []
    for latents in (torch.randn(1, 8), torch.randn(1, 8)):
        alone = torch.cat([errors(latents, torch.eye(4)[state][None]) for state in range(4)])
        gaps.append((chance[0] * alone).sum() - errors(latents, chance)[0])
    assert gaps[0] > 1e-3 and torch.isclose(gaps[0], gaps[1], rtol=1e-3)


@pytest.mark.parametrize("missing", [False, True])
def test_equal_and_missing_pictures_leave_no_components_of_rounding_errors(missing):
    size = 64
    pictures, index = pictures_and_index(6, 2, size)
    pictures[index[3:]] = pictures[index[:3]]  # six states, three pictures at each camera
    if missing:
        index = index.clone()
        index[4:, 1] = -1
    torch.manual_seed(0)
    decoder = ComponentsDecoder(DecoderConfig(width=16), 8, 2, 6, size, size)
    decoder.fit_basis(pictures, index)
    for camera in range(2):
        basis = decoder.basis[camera].float()
        used = basis.norm(dim=-1) > 0
        assert used.sum() == 2, "three pictures span two dimensions around their mean"
        assert torch.allclose(basis[used] @ basis[used].T, torch.eye(2), atol=1e-3)
        assert (decoder.weight[camera, ~used] == 0).all() and (decoder.weight[camera, used] > 0).all()
    assert decoder.unreached.max() < 1e-2, "squared error summed over 12288 values"
    for state in range(4):
        flat = decoder.mean[0] + decoder.targets[state, 0] @ decoder.basis[0].float()
        assert torch.allclose(flat, pictures[index[state, 0]].flatten().float() / 255, atol=5e-3)


@pytest.mark.parametrize("rank", [1, 16])
def test_pixel_errors_are_those_of_the_pictures(rank):
    decoder = components(rank=rank)
    decoder.weight = decoder.weight * 7  # training weights must not count
    pictures, index = pictures_and_index()
    latents = torch.randn(1, 8) * 0.1
    own = decoder.coefficients(latents)[0]
    flat = decoder.mean + torch.einsum("cr,crp->cp", own, decoder.basis.float())
    expected = (flat - pictures[index[2]].flatten(1).float() / 255).square().mean()
    found = decoder.pixel_errors(latents, torch.tensor([2]), torch.Generator())
    assert torch.isclose(found[0], expected, rtol=2e-3)


def test_true_coefficients_give_the_true_picture():
    decoder = components()
    pictures, index = pictures_and_index()
    flat = decoder.mean[1] + decoder.targets[2, 1] @ decoder.basis[1].float()
    assert torch.allclose(flat, pictures[index[2, 1]].flatten().float() / 255, atol=2e-3)


def test_a_missing_view_adds_nothing_to_the_loss():
    torch.manual_seed(0)
    decoder = ComponentsDecoder(DecoderConfig(width=16), 8, 3, 4, 8, 8)
    pictures, index = pictures_and_index()
    index = index.clone()
    index[2, 1] = -1
    decoder.fit_basis(pictures, index)
    latents = torch.randn(1, 8)
    for chance in (torch.tensor([[0.0, 0, 1, 0]]), torch.tensor([[0.5, 0, 0.5, 0]])):
        before = decoder.reconstruction_errors(latents, chance, torch.Generator())
        decoder.targets[2, 1] += 100.0
        assert decoder.reconstruction_errors(latents, chance, torch.Generator()) == before


def test_one_state_and_a_camera_without_pictures_are_finite():
    torch.manual_seed(0)
    decoder = ComponentsDecoder(DecoderConfig(width=16), 8, 2, 1, 8, 8)
    pictures, _ = pictures_and_index(1, 1)
    decoder.fit_basis(pictures, torch.tensor([[0, -1]]))
    errors = decoder.reconstruction_errors(torch.randn(2, 8), torch.ones(2, 1), torch.Generator())
    errors.mean().backward()
    assert torch.isfinite(errors).all()
    assert all(torch.isfinite(p.grad).all() for p in decoder.parameters())


@pytest.mark.parametrize("camera", ["one_hot", "pose"])
def test_conv_decoder_learns_one_picture_per_state(camera):
    torch.manual_seed(0)
    poses = torch.eye(4).repeat(2, 1, 1)
    poses[1, 0, 3] = 3.0
    code = torch.eye(2) if camera == "one_hot" else pose_code(poses, torch.tensor([[-4.0, -4, -4], [4, 4, 4]]))
    decoder = ConvDecoder(DecoderConfig(kind="conv", camera=camera, width=32), 2, code, 16)
    pictures = torch.zeros(4, 16, 16, 3, dtype=torch.uint8)
    pictures[1], pictures[2, :8], pictures[3, :, :8] = 200, 200, 200
    decoder.fit_basis(pictures, torch.tensor([[0, 1], [2, 3]]))
    latents = torch.eye(2)
    optimizer = torch.optim.Adam(decoder.parameters(), lr=0.01)
    generator = torch.Generator().manual_seed(0)
    for _ in range(150):
        loss = decoder.reconstruction_errors(latents, torch.eye(2), generator).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    shown = decoder.pictures(torch.tensor([[0.0, 1.0]]), torch.tensor([1]))
    # The mean of camera 1 over both states errs by 100 levels on half of the pixels: squared error 0.077.
    assert (shown[0] - pictures[3].float() / 255).square().mean() < 0.01


def test_conv_decoder_leaves_missing_views_out():
    torch.manual_seed(0)
    decoder = ConvDecoder(DecoderConfig(kind="conv", width=16, targets=400), 2, torch.eye(2), 8)
    pictures = torch.zeros(3, 8, 8, 3, dtype=torch.uint8)
    pictures[1] = 255
    decoder.fit_basis(pictures, torch.tensor([[0, 1], [2, -1]]))
    decoder.decode = lambda latents, camera: torch.zeros(len(latents), 3, 8, 8)
    # State 1 is seen by camera 0 alone (black: no error); state 0 by camera 1 too (white: error 1). With chances
    # 1/4 and 3/4 camera 0 is drawn four times as often as camera 1, whose picture is then state 0's.
    chance = torch.tensor([[0.25, 0.75]])
    errors = decoder.reconstruction_errors(torch.zeros(1, 2), chance, torch.Generator().manual_seed(0))
    assert abs(float(errors) - 0.2) < 0.05


def test_conv_decoder_refuses_sizes_it_cannot_build():
    with pytest.raises(UserError, match="power of two"):
        ConvDecoder(DecoderConfig(kind="conv"), 2, torch.eye(2), 48)


def test_config_names_the_bad_key():
    with pytest.raises(UserError, match=r"decoder.components"):
        DecoderConfig(components=0)
