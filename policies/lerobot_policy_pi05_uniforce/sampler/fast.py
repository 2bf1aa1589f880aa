"""Sample an action chunk as LeRobot's π0.5 does, without repeated or unread work.

Same weights and mathematics, another order of summation: actions are equal within 1e-4. Left out:

- cameras that are missing and text that is padding;
- the last VLM layer after its keys and values;
- copies of the prefix cache in every flow step;
- the norms' modulation, which depends on the flow time alone: it is kept in a table per step;
- attention matrices of the prefix, by torch's fused attention;
- masks, positions and rotations, built once.

In bfloat16 the cameras are encoded in bfloat16 too.

On a CUDA device a whole call, prefix and flow, is replayed from one graph. For that, text is padded
to one of a few lengths (a graph each) and masks are always there. Touch is encoded before it, from
a graph of its own (``touch/encoder.py``): the health monitor, on the host, decides between latents
and actions.
"""

import copy
import functools
import logging
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.cuda_graphs import Recording, Recordings
from lerobot_policy_pi05_uniforce.network import Inputs, PI05UniforcePytorch
from lerobot_policy_pi05_uniforce.sampler.layers import (
    Prepared,
    StepTable,
    attend_folded,
    modulated,
    rotated,
)
from lerobot_policy_pi05_uniforce.sampler.prefix import Prefix, drop_dead, encode

logger = logging.getLogger(__name__)

BUCKETS = (96, 200)  # text tokens: a usual prompt, and π0.5's most


class FastSampler:
    """Samples for one network; weights that changed since the last call are prepared again.

    Attributes:
        recordings: of whole calls, where they are replayed from CUDA graphs.
        compiles: compile what is recorded from now on, for prompts of the first bucket. That takes
            long, so only a policy's warm-up asks for it; later shapes are recorded as they are.
    """

    def __init__(self, network: PI05UniforcePytorch) -> None:
        self.network = network
        self.prepared = Prepared(network)
        self.recordings: Recordings | None = None  # made where there is a cuda device
        self.compiles = False
        self._recorded = -1  # version of the weights
        # one compiled form of each function, for all recordings
        self._compiled = functools.cache(functools.partial(torch.compile, dynamic=False))

    @torch.no_grad()
    def sample(self, inputs: Inputs, noise: Tensor, num_steps: int) -> Tensor:
        """Return (B, chunk, max_action_dim) actions."""
        tables = self.prepared.tables(num_steps)
        inputs = drop_dead(inputs)
        if self.recordings is None and self.is_graphed_on(noise.device):
            self.recordings = Recordings()
        if self.recordings is None:
            return self.run(inputs, noise, tables)
        if self._recorded != self.prepared.version:  # other weights: tables were made anew
            self.recordings.kept.clear()
            self._recorded = self.prepared.version
        tokens, masks = bucketed(inputs.tokens, inputs.masks)
        inputs = inputs._replace(tokens=tokens, masks=masks)
        key = (len(tables), len(inputs.images))
        record = functools.partial(self._record, inputs, noise, tables, self.recordings.capture)
        return self.recordings.call(key, flattened(inputs, noise), record)

    def is_graphed_on(self, device: torch.device) -> bool:
        """Return whether a device's calls are replayed from CUDA graphs."""
        return device.type == "cuda" and self.network.config.sampler.kind == "fast"

    def run(
        self,
        inputs: Inputs,
        noise: Tensor,
        tables: list[StepTable],
        always_mask: bool = False,
        through: Callable[[Callable], Callable] = lambda function: function,
    ) -> Tensor:
        """Return the actions at the end of the flow from ``noise``, by Euler's method.

        Args:
            inputs: of the observation.
            noise: (B, chunk, max_action_dim).
            tables: one for each flow step.
            always_mask: as ``encode``'s.
            through: makes another function of each of the two that are run, a compiled one.
        """
        prefix = through(encode)(self.network, self.prepared, inputs, noise.shape[1], always_mask)
        x = noise
        for table in tables:
            step = through(velocity)(self.network, self.prepared, prefix, x, table)
            x = torch.add(x, step, alpha=-1.0 / len(tables))
        return x

    def _record(
        self, inputs: Inputs, noise: Tensor, tables: list[StepTable], capture: bool
    ) -> Recording:
        observed, start = copy.deepcopy((inputs, noise))
        buffers = flattened(observed, start)
        run = functools.partial(self.run, observed, start, tables, always_mask=True)
        if self.compiles and inputs.tokens.shape[1] <= BUCKETS[0]:
            try:
                return Recording(functools.partial(run, through=self._compiled), buffers, capture)
            except RuntimeError as error:  # of dynamo, inductor, Triton or its C compiler
                self.compiles = False
                reason = str(error).partition("\n")[0][:200]
                logger.warning("torch.compile fails, kernels run as they are: %s", reason)
        return Recording(run, buffers, capture)


def velocity(
    network: PI05UniforcePytorch,
    prepared: Prepared,
    prefix: Prefix,
    actions: Tensor,
    table: StepTable,
) -> Tensor:
    """Return (B, chunk, max_action_dim) velocity of noisy actions at a table's flow time."""
    eps = prepared.eps
    x = network.action_in_proj(actions).to(prepared.dtype)  # (B, chunk, D)
    for depth, layer in enumerate(network.expert.layers):
        attention = table[2 * depth]
        mlp = table[2 * depth + 1]
        rows = F.linear(modulated(x, attention, eps), prepared.qkv[depth])
        turned = rotated(rows, prefix.rotary, layer.self_attn.head_dim)
        cache = prefix.cache[depth]
        cache[:, :, prefix.length :] = turned[:, -2:]
        mixed = attend_folded(turned[:, :-2], cache, prefix.mask)
        x = torch.addcmul(x, layer.self_attn.o_proj(mixed), attention.gate)
        gate, up = F.linear(modulated(x, mlp, eps), prepared.gate_up[depth]).chunk(2, dim=-1)
        hidden = F.gelu(gate, approximate="tanh") * up
        x = torch.addcmul(x, layer.mlp.down_proj(hidden), mlp.gate)
    return network.action_out_proj(modulated(x, table[-1], eps).float())


def flattened(inputs: Inputs, noise: Tensor) -> list[Tensor]:
    """Return the tensors of a call, one behind the other."""
    felt = inputs.felt
    seen = [*inputs.images, *inputs.img_masks, inputs.tokens, inputs.masks, noise]
    return [*seen, *filter(torch.is_tensor, (felt.state, felt.touches, felt.masks))]


def bucketed(tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Pad (B, L) text to the next of ``BUCKETS``, masked, so that another length finds a graph."""
    length = tokens.shape[1]
    room = min((size - length for size in BUCKETS if size >= length), default=0)
    return F.pad(tokens, (0, room)), F.pad(masks.bool(), (0, room))
