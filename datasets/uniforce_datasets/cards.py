"""An episode in words, ``cards/episode_000017.json``: written with the episode or not at all."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import DatasetError, expected, without_credentials


def card_path(root: Path, episode: int) -> Path:
    """Return where an episode's card is."""
    return root / "cards" / f"episode_{episode:06d}.json"


def write_card(staged: Path, episode: int, card: Mapping[str, Any] | None) -> None:
    """Write a card into the staging folder, without credentials; nothing where there is none."""
    if card is None:
        return
    path = card_path(staged, episode)
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"episode": episode, **card}, indent=1, ensure_ascii=False, default=str)
    path.write_text(without_credentials(text) + "\n")


def read_card(root: str | Path, episode: int) -> dict[str, Any]:
    """Return an episode's card; DatasetError: it has none."""
    path = card_path(Path(root), episode)
    if not path.is_file():
        do = "Simulated demos of the expert have none; LeRobot's edit tools leave cards behind."
        raise DatasetError(expected(str(path), "an episode's card", "none", do))
    card: dict[str, Any] = json.loads(path.read_text())
    return card
