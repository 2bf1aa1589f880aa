"""The chosen calibration is judged on grasps that had no part in its choice; only development
objects are read."""

from dataclasses import replace

import numpy as np
import torch

from benchmarks import calibration_choice
from benchmarks.calibration_choice import Case, compare, line, real_cases
from benchmarks.real.grasps import SEALED, SEEN, Grasp
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.tokenizer import Tokenizer


def head(z):
    """Read the first three numbers of a latent."""
    return z.as_subclass(torch.Tensor)[:, 0, :3]


head.tokenizer_hash = "abc"


def case(new, anchor):
    rows = np.arange(len(new))
    return Case(new, anchor, rows, rows % 5, head, (0, 1, 2))


def latents(seed):
    return torch.randn(100, 4, 6, generator=torch.Generator().manual_seed(seed))


def test_a_weaker_finger_is_calibrated_and_an_equal_one_is_not():
    anchor = latents(0)
    weaker, equal = compare(case(0.6 * anchor, anchor)), compare(case(anchor, anchor))
    assert weaker["error"]["chosen"] < 0.01 < weaker["error"]["none"] and weaker["never_worse"]
    assert [choice["form"] for choice in equal["choices"]] == ["none"] * 5 and equal["never_worse"]
    assert "(none none none none none)" in line("equal", equal)


def test_a_choice_that_does_harm_where_it_is_judged_is_called_worse():
    """The grasps that choose are of a weak finger; in those that judge, the same finger answers
    fully."""
    anchor = latents(0)
    weak = case(0.6 * anchor, anchor)
    parts = np.where(np.arange(100) < 60, -1, 0)
    new = torch.cat([weak.new[:60], anchor[60:]])
    found = compare(replace(weak, new=new, parts=parts))
    assert found["grasps"] == 40 and len(found["choices"]) == 1
    assert found["error"]["none"] == 0.0 < found["error"]["chosen"] and not found["never_worse"]


def test_development_objects_alone_are_read(monkeypatch, tiny):
    images = np.zeros((2, *MARKER_IMAGE_SHAPE), np.uint8)
    images[:, 200:280, 280:360] = 255
    both = {"left": images, "right": images}
    references = {"left": images[0], "right": images[0]}
    held = [*SEALED, *SEEN, "lemon", "lemon", "mug", "mug", "ball"]
    grasps = [Grasp(name, "close", references, both) for name in held]
    monkeypatch.setattr(calibration_choice, "read_grasps", lambda folder: folder)
    monkeypatch.setattr(calibration_choice, "find_grasps", lambda trials: grasps)
    tokenizer = Tokenizer.random(tiny)
    cases = real_cases("", tokenizer, head)
    by_trial = cases["GelSight Mini close, left finger, a left-out trial"]
    by_object = cases["GelSight Mini close, left finger, a left-out object"]
    assert len(cases) == 4 and len(by_trial.new) == 10
    assert len(set(by_trial.grasps.tolist())) == 5 and len(set(by_object.grasps.tolist())) == 3
    del grasps[len(SEALED) + len(SEEN) :]
    assert real_cases("", tokenizer, head) == {}
