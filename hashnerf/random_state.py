"""Random number generators: one seed for all of them, and their exact state as tensors and numbers.

`capture_random_state` returns a tree (dicts, lists, numbers, tensors) that `hashnerf.checkpoints.pack` can store
without pickle; restoring it continues every stream at the very next draw.
"""

import random
from typing import Any

import numpy as np
import torch

from hashnerf.errors import UserError


def seed_everything(seed: int) -> None:
    """Seed Python's, NumPy's and torch's global generators (all devices); UserError outside 0 .. 2**32 - 1."""
    if not 0 <= seed < 2**32:
        raise UserError(f"seed = {seed} is outside 0 .. 2**32 - 1; choose a seed in that range.")
    random.seed(seed)
    np.random.seed(seed)  # the global generator is seeded because libraries (scikit-learn) draw from it
    torch.manual_seed(seed)


def capture_random_state(generators: dict[str, torch.Generator] | None = None) -> dict[str, Any]:
    """Take the exact state of Python's, NumPy's and torch's global generators and of the named torch generators."""
    version, words, gauss = random.getstate()
    numpy_state = np.random.get_state(legacy=False)
    state = {
        "python": {"version": version, "words": torch.tensor(words), "gauss": gauss},
        "numpy": {
            "words": torch.from_numpy(numpy_state["state"]["key"].astype(np.int64)),
            "position": int(numpy_state["state"]["pos"]),
            "has_gauss": int(numpy_state["has_gauss"]),
            "gauss": float(numpy_state["gauss"]),
        },
        "torch": torch.get_rng_state(),
        "generators": {name: generator.get_state() for name, generator in (generators or {}).items()},
    }
    if torch.cuda.is_available() and torch.cuda.is_initialized():
        state["cuda"] = torch.cuda.get_rng_state_all()
    return state


def restore_random_state(state: dict[str, Any], generators: dict[str, torch.Generator] | None = None) -> None:
    """Put every generator back to a captured state; UserError when the named generators are not the captured ones."""
    named = generators or {}
    if set(named) != set(state["generators"]):
        raise UserError(
            f"the saved random generators are {sorted(state['generators'])}, but this run has {sorted(named)}; "
            "resume with the code that wrote the checkpoint."
        )
    python, numpy_state = state["python"], state["numpy"]
    random.setstate((python["version"], tuple(python["words"].tolist()), python["gauss"]))
    words = numpy_state["words"].numpy().astype(np.uint32)
    np.random.set_state(("MT19937", words, numpy_state["position"], numpy_state["has_gauss"], numpy_state["gauss"]))
    torch.set_rng_state(state["torch"])
    for name, generator in named.items():
        generator.set_state(state["generators"][name])
    if "cuda" in state and torch.cuda.is_available():
        for device, device_state in zip(range(torch.cuda.device_count()), state["cuda"]):
            torch.cuda.set_rng_state(device_state, device)
