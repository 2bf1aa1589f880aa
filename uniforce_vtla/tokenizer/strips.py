"""Strips of reconstructions: what the decoder draws from each finger's latent, while training runs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from uniforce_vtla.tokenizer.model import ForceAutoencoder
from uniforce_vtla.tokenizer.pair_cache import Pairs


@torch.no_grad()
def draw_strips(model: ForceAutoencoder, pairs: Pairs, path: Path) -> Path:
    """Write a PNG, one row per pair: left reference, current, drawn from z_L and z_R; then the right finger's four."""
    per_unit = len(pairs.left_current) // len(pairs.left_reference)
    left, right = (r.repeat_interleave(per_unit, 0) for r in (pairs.left_reference, pairs.right_reference))
    z_left, z_right = model(left, pairs.left_current).mean, model(right, pairs.right_current).mean
    columns = [
        *(left, pairs.left_current, model.decoder(left, z_left), model.decoder(left, z_right)),
        *(right, pairs.right_current, model.decoder(right, z_right), model.decoder(right, z_left)),
    ]
    rows = torch.cat(columns, dim=3)[:, 0]  # (B, S, 8·S)
    picture = (rows.clamp(0, 1) * 255).round().numpy().astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.concatenate(list(picture)))
    return path
