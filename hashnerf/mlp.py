"""Small bias-free ReLU networks, evaluated a cache-sized block of rows at a time.

A chain of 64-wide layers over 100,000 rows is limited by memory, not by arithmetic; block by block its activations stay
in the cache. The forward pass keeps the activations of every block for the backward pass. In low precision products are
bfloat16 (which has the range of float32) where the device multiplies it in hardware; weights, their gradients and the
output stay float32 (or float64).
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hashnerf.low_precision import multiplies_bfloat16, without_autocast

BLOCK = 4096  # rows: 4096 x 64 activations of 2 bytes fit the second-level cache several times
GRAIN = 512  # a last block is filled up to a multiple: half-precision products of a size not met before cost 2 ms each


class _BlockedMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx, dtype: torch.dtype, layers: int, *tensors: Tensor) -> Tensor:
        weights, parts = tensors[:layers], tensors[layers:]
        rows = parts[0].shape[0]
        low = [weight.to(dtype) for weight in weights]
        out = parts[0].new_empty(rows, weights[-1].shape[0], dtype=weights[-1].dtype)
        kept: list[Tensor] = []
        for block in _blocks(parts[0]):
            x = _filled(torch.cat([part[block].to(dtype) for part in parts], dim=1), dtype)
            for weight in low[:-1]:
                kept.append(x)
                x = torch.relu_(x @ weight.t())
            kept.append(x)
            out[block] = (x @ low[-1].t())[: len(out[block])]
        # activations never leave this function, so no one can change them in place: saving them plainly is safe
        ctx.kept, ctx.low, ctx.dtype = kept, low, dtype
        ctx.widths = [part.shape[1] for part in parts]
        ctx.part_dtypes = [part.dtype for part in parts]
        ctx.weight_dtype = weights[0].dtype
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    @without_autocast  # forward is told by MLP; a backward pass inside an autocast would multiply in half precision
    def backward(ctx, gradient: Tensor) -> tuple[Tensor | None, ...]:
        low, layers = ctx.low, len(ctx.low)
        wanted = ctx.needs_input_grad[2 + layers :]
        # sums over blocks are kept in full precision
        for_weights = [torch.zeros_like(weight, dtype=ctx.weight_dtype) for weight in low]
        for_parts = [
            gradient.new_empty(len(gradient), width, dtype=dtype) if want else None
            for width, dtype, want in zip(ctx.widths, ctx.part_dtypes, wanted)
        ]
        for number, block in enumerate(_blocks(gradient)):
            activations = ctx.kept[number * layers : (number + 1) * layers]
            slope = _filled(gradient[block].to(ctx.dtype), ctx.dtype)
            for layer in reversed(range(layers)):
                for_weights[layer] += slope.t() @ activations[layer]
                if layer == 0 and not any(wanted):
                    break
                slope = slope @ low[layer]
                if layer:
                    slope = torch.ops.aten.threshold_backward(slope, activations[layer], 0)
            if any(wanted):
                for part, piece in zip(for_parts, slope.split(ctx.widths, dim=1)):
                    if part is not None:
                        part[block] = piece[: len(part[block])]
        return None, None, *for_weights, *for_parts


def _filled(rows: Tensor, dtype: torch.dtype) -> Tensor:
    """Rows with zeros below them, which change no product: the library compiles a kernel for every new size."""
    missing = -len(rows) % GRAIN if dtype == torch.bfloat16 and rows.device.type == "cpu" else 0
    return nn.functional.pad(rows, (0, 0, 0, missing)) if missing else rows


def _blocks(rows: Tensor) -> list[slice]:
    """Cut rows into blocks on a processor; an accelerator takes them all at once."""
    count = len(rows)
    size = BLOCK if rows.device.type == "cpu" else max(count, 1)
    return [slice(start, start + size) for start in range(0, count, size)]


class MLP(nn.Module):
    """ReLU network without biases: a constant input, such as the lowest harmonic, serves as one."""

    def __init__(self, inputs: int, width: int, hidden_layers: int, outputs: int, low_precision: bool = False):
        super().__init__()
        sizes = [inputs, *[width] * hidden_layers, outputs]
        self.low_precision = low_precision
        self.weights = nn.ParameterList(
            nn.Parameter(nn.init.kaiming_uniform_(torch.empty(rows, columns), nonlinearity="relu"))
            for columns, rows in pairwise(sizes)
        )

    @property
    def dtype(self) -> torch.dtype:
        """Arithmetic of the products."""
        weight = self.weights[0]
        low = self.low_precision and multiplies_bfloat16(weight.device.type)
        return torch.bfloat16 if low else weight.dtype

    def forward(self, parts: Sequence[Float[Tensor, "n _"]]) -> Float[Tensor, "n outputs"]:
        """Apply the network to the columns of all parts side by side."""
        # an outer autocast must not choose the arithmetic: the backward pass would not follow
        with torch.autocast(parts[0].device.type, enabled=False):
            return _BlockedMLP.apply(self.dtype, len(self.weights), *self.weights, *parts)

    def first_output_bank(
        self, x: Float[Tensor, "n columns"], bank: Float[Tensor, "bank extra"] | None
    ) -> Float[Tensor, "bank_or_one n"]:
        """Return the first output for the rows of `x` beside each row of `bank`; what rows share is done once."""
        with torch.autocast(x.device.type, enabled=False):  # as in forward: the bank shall agree with it
            return self._first_output_bank(x, bank)

    def _first_output_bank(self, x: Tensor, bank: Tensor | None) -> Tensor:
        first, *rest = (weight.to(self.dtype) for weight in self.weights)
        columns = x.shape[1]
        shared = x.to(self.dtype) @ first[:, :columns].t()
        shifts = torch.zeros_like(first[:1, :0]) if bank is None else bank.to(self.dtype)
        rows = []
        for shift in shifts @ first[:, columns:].t():  # one at a time: its activations stay in the cache
            hidden = torch.relu(shared + shift)
            for weight in rest[:-1]:
                hidden = torch.relu(hidden @ weight.t())
            rows.append((hidden @ rest[-1][0]).to(self.weights[0].dtype))
        return torch.stack(rows)
