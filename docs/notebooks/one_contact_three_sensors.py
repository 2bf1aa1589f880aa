# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # One contact, three sensors
#
# A ball presses on a pad and drags it. The same contact is put on three simulated sensors.
# One tokenizer turns what they show into latents, and one force head reads newtons in those.
# At the end the shipped policy wipes a board twice: once with its own sensor, once with another.
#
# All of it is simulated. It needs no network, and about half a minute on one core.

# %%
import matplotlib.pyplot as plt
import numpy as np
import torch

from uniforce_cli.score_settings import Rig
from uniforce_cli.score_worker import policy_on_rig
from uniforce_vtla import Canonicalizer, ForceHead, Tokenizer
from uniforce_vtla.contact import TactileSimulator, gap_map
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.rollout import roll_out
from uniforce_vtla.markers.raster import overlay

torch.set_num_threads(1)
np.set_printoptions(precision=2, suppress=True)

# %% [markdown]
# ## The contact
#
# A force has three parts, in the axes of the image: x to the right, y down, z into the pad.
# The ball presses with 2, 4 and 6 N, and the shear grows with the press.
# The same force goes deeper into a soft pad than into a stiff one.

# %%
# (3, 3)
FORCE_N = np.array([(0.75, -0.375, 2.0), (1.5, -0.75, 4.0), (2.25, -1.125, 6.0)], np.float32)
ball = np.repeat(gap_map("sphere", center_mm=(0.0, 0.0), angle_rad=0.0)[None], len(FORCE_N), axis=0)
contact = ContactState(ball, FORCE_N, torsion_Nmm=np.zeros(len(FORCE_N), np.float32))
simulators = {name: TactileSimulator(name) for name in ("gelsight", "tactip", "uskin")}
for name, simulator in simulators.items():
    print(f"{name:9} depth [mm] at 2, 4 and 6 N: {simulator.depth_mm(contact)}")

# %% [markdown]
# ## Images of the sensors
#
# Each simulator gives what a driver would give: camera frames, or counts of taxels.
# The canonicalizer turns them into marker images, as on a robot.
# Cyan: where a marker is in free air. Red: where it is under load. White: both.

# %%
pairs = {}
for name, simulator in simulators.items():
    canonicalizer, reference = Canonicalizer(name), simulator.raw_reference()
    raw = [reference, *simulator.raw_frames(contact)]  # the first is free air
    pairs[name] = [canonicalizer.pair(reference, frame, finger="left") for frame in raw]

figure, panels = plt.subplots(3, 3, figsize=(10, 7.6), layout="constrained")
for line, (name, shown) in zip(panels, pairs.items(), strict=True):
    for panel, pair, force_N in zip(line, shown[1:], FORCE_N, strict=True):
        panel.imshow(overlay(pair.reference, pair.current), interpolation="antialiased")
        panel.set(xticks=[], yticks=[], title=f"{name}, {force_N[2]:.0f} N")
plt.show()

# %% [markdown]
# ## The latent
#
# The tokenizer gives 8 × 8 patches of six numbers. Their change from free air counts.
# The pictures are of 6 N, all on one colour scale.

# %%
tokenizer = Tokenizer.from_pretrained()
# (1, P, L) each
latents = {name: [tokenizer.encode(pair) for pair in shown] for name, shown in pairs.items()}
change = {
    name: np.stack([(z - free)[0].numpy() for z in loaded])
    for name, (free, *loaded) in latents.items()
}

grid, numbers = tokenizer.config.grid, tokenizer.config.latent
most = max(np.abs(z[-1]).max() for z in change.values())
figure, panels = plt.subplots(3, numbers, figsize=(10, 5.2), layout="constrained")
for line, (name, z) in zip(panels, change.items(), strict=True):
    line[0].set_ylabel(name)
    for number, panel in enumerate(line):
        picture = panel.imshow(
            z[-1, :, number].reshape(grid, grid), cmap="RdBu_r", vmin=-most, vmax=most
        )
        panel.set(xticks=[], yticks=[], title=f"number {number}")
figure.colorbar(picture, ax=panels, shrink=0.7, label="latent − free air")
plt.show()

# %% [markdown]
# How alike are they? The cosine between two changes is 1 where they point the same way.
# The distance is given relative to the length of the second: 0 where both are the same.


# %%
def alike(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Return the cosine between two changes of latents (P, L), and their distance over the length of the second."""
    length = np.linalg.norm(other)
    return float((one * other).sum() / np.linalg.norm(one) / length), float(
        np.linalg.norm(one - other) / length
    )


def compare(label: str, one: np.ndarray, other: np.ndarray) -> None:
    """Print how alike two changes are."""
    cosine, distance = alike(one, other)
    print(f"{label:28} cosine {cosine:.2f}, distance {distance:.2f}")


for step, force_N in enumerate(FORCE_N):
    for name in ("gelsight", "uskin"):
        compare(f"{force_N[2]:.0f} N, {name} to tactip", change[name][step], change["tactip"][step])
print("For scale, one sensor and two forces:")
compare("tactip, 4 N to 6 N", change["tactip"][1], change["tactip"][2])
compare("tactip, 2 N to 6 N", change["tactip"][0], change["tactip"][2])

# %% [markdown]
# So the latents are similar, but not the same. Two sensors under one force are further apart than 4 N and 6 N are on
# one of them, and nearer than 2 N and 6 N.
#
# ## The force
#
# This head learnt from a TacTip alone. It never saw a force on the two others.

# %%
head = ForceHead.from_pretrained("tactip")
read_N = {
    name: np.concatenate([head(z).numpy() for z in loaded])
    for name, (_, *loaded) in latents.items()
}
print("fx, fy, fz in N".ljust(16) + "".join(f"{name:21}" for name in ("truth", *read_N)))
for step in range(len(FORCE_N)):
    cells = (
        ",".join(f"{newton:6.2f}" for newton in forces_N[step])
        for forces_N in (FORCE_N, *read_N.values())
    )
    print(" " * 15 + " ".join(cells))
for name, forces_N in read_N.items():
    print(f"{name}: mean error {np.abs(forces_N - FORCE_N).mean(axis=0)} N")

figure, panels = plt.subplots(1, 3, figsize=(10, 3.4), layout="constrained")
for panel, axis, label in zip(
    panels, range(3), ("fx, right", "fy, down", "fz, compression"), strict=True
):
    panel.plot(FORCE_N[:, 2], FORCE_N[:, axis], "k--", label="truth")
    for name, forces_N in read_N.items():
        panel.plot(FORCE_N[:, 2], forces_N[:, axis], "o-", label=name)
    panel.set(xlabel="true press [N]", ylabel="force [N]", title=label)
    panel.grid(alpha=0.3)
panels[0].legend()
plt.show()

# %% [markdown]
# The press is read alike on all three. On the uSkin shear is read too weak at 6 N.
# These sensors are as drawn, and one ball is an easy contact.
# [Numbers over many contacts and units](../evidence.md) are worse.
#
# ## The sensor is exchanged under a policy
#
# The shipped policy learnt with a TacTip on the right finger. It wipes one scene with it, then the same scene with a
# uSkin there. Nothing is retrained or calibrated. The task is to press with 4 to 8 N.
# The scene is for development: it was not trained on, and no result rests on it.

# %%
SCENE = 21_500
rollouts = {}
for right in ("tactip", "uskin"):
    scene, policy = policy_on_rig("shipped", Rig("touch", right_sensor=right))
    torch.manual_seed(SCENE)  # the policy draws its noise from here
    rollouts[right] = roll_out(scene, policy, SCENE, keep_shots=True)
    result = rollouts[right].result
    reasons = "; ".join(result.reasons) or "none"
    ink, share = result.metrics["residual"], result.metrics.get("in_band_share", 0.0)
    print(
        f"{right}: {result.outcome}, events: {reasons}; {ink:.0%} of the ink left, {share:.0%} wiped in the band"
    )

# %%
SHOWN = 6
figure, panels = plt.subplots(2, SHOWN, figsize=(12, 4.4), layout="constrained")
for line, (right, rollout) in zip(panels, rollouts.items(), strict=True):
    line[0].set_ylabel(right)
    for panel, number in zip(
        line, np.linspace(0, len(rollout.shots) - 1, SHOWN).astype(int), strict=True
    ):
        panel.imshow(rollout.shots[number].front)
        at_s = number / len(rollout.shots) * rollout.trace.time_s[-1]
        panel.set(xticks=[], yticks=[], title=f"{at_s:.1f} s")
plt.show()

# %%
low_N, high_N = ScoreLimits().band_N
figure, (press, ink) = plt.subplots(2, 1, figsize=(10, 5.4), sharex=True, layout="constrained")
press.axhspan(low_N, high_N, color="tab:green", alpha=0.15, label="asked for")
for right, rollout in rollouts.items():
    press.plot(rollout.trace.time_s, rollout.trace.press_N, label=right)
    ink.plot(rollout.trace.time_s, 100 * rollout.trace.residual, label=right)
press.set(
    ylabel="press on the board [N]",
    title="the same scene, two sensors (true press of the simulator)",
)
ink.set(ylabel="ink left [%]", xlabel="time [s]")
press.legend(loc="upper left")
plt.show()

# %% [markdown]
# With both sensors the board is wiped, and both press too hard for about a second.
# One scene says little. `uniforce score` counts over many, see [the tutorial](../tutorial.md#6-swap).
