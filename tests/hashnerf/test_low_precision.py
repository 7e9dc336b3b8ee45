import pytest
import torch

from hashnerf.low_precision import multiplies_bfloat16, without_autocast


@pytest.fixture(autouse=True)
def asked_anew():
    multiplies_bfloat16.cache_clear()
    yield
    multiplies_bfloat16.cache_clear()


@pytest.mark.parametrize("avx512, amx, expected", [(False, False, False), (True, False, True), (False, True, True)])
def test_a_processor_needs_units_for_bfloat16(monkeypatch, avx512, amx, expected):
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: avx512)
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: amx)
    assert multiplies_bfloat16("cpu") is expected


def test_a_gpu_is_asked_whether_it_emulates(monkeypatch):
    asked = {}
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda **options: asked.update(options) or False)
    assert not multiplies_bfloat16("cuda")
    assert asked == {"including_emulation": False}


def test_an_unknown_kind_of_device_gets_float32():
    assert not multiplies_bfloat16("mps")


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_without_autocast_products_keep_their_precision(dtype):
    a, b = torch.randn(2, 8, 8)
    product = without_autocast(torch.matmul)
    with torch.autocast("cpu", dtype=dtype):
        assert (a @ b).dtype == dtype
        assert torch.equal(product(a, b), product(a, other=b)) and product(a, b).dtype == torch.float32
        assert (a @ b).dtype == dtype, "only inside the function"
    assert torch.equal(product(a, b), a @ b)


def test_half_precision_layers_inside_follow_their_weights():
    layer, x = torch.nn.Linear(4, 4, bias=False), torch.ones(1, 4)

    def seen():
        with torch.autocast("cpu", dtype=torch.bfloat16):
            return layer(x).detach()

    @without_autocast
    def two_steps():
        before = seen()
        with torch.no_grad():
            layer.weight.mul_(2)
        return before, seen()

    before, after = two_steps()
    assert torch.equal(after, 2 * before)
