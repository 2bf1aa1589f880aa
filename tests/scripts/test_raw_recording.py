"""Raw frames beside a recording, and taxel counts in it, are shown where they were kept."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from uniforce_cli.recorded_episode import raw_touch
from uniforce_cli.show import main
from uniforce_datasets.features import flat_column
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.source import read_source
from uniforce_datasets.synthetic import FPS, synthetic_frame
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import counts_key

FRAMES = 8
RAW = (48, 64, 3)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return two episodes: raw frames that brighten on the left, counts that grow by 100 a frame on the right."""
    root, rng = tmp_path_factory.mktemp("raw") / "dots", np.random.default_rng(0)
    further = {counts_key("right"): flat_column(48, "int32")}
    with EpisodeRecorder(
        root, "local/raw", "gelsight", "uskin", FPS, further=further, raw_shapes={"left": RAW}
    ) as recorder:
        for number in range(2):
            for step in range(FRAMES):
                counts = np.full(48, 5000 + 1000 * number + 100 * step, np.int32)
                frame = synthetic_frame(step, rng) | {counts_key("right"): counts}
                recorder.add(frame, "wipe", {"left": np.full(RAW, 20 * step, np.uint8)})
            recorder.save(success=True, outcome="success", seed=number)
    return root


def test_frames_and_counts_are_the_episodes_own(recorded: Path) -> None:
    source = read_source(recorded)
    left, right = (raw_touch(source, source.episodes[1], finger) for finger in ("left", "right"))
    assert left is not None and right is not None
    brightness = [frame.mean() for frame in left]
    assert np.allclose(brightness, 20 * np.arange(FRAMES), atol=4)
    # since the first frame: 1,000 counts more there say nothing
    change = [int(picture.max()) for picture in right]
    assert change == [int(100 * step / 4000 * 255) for step in range(FRAMES)]


def test_what_was_not_kept_is_not_shown_and_what_is_truncated_is_an_error(recorded: Path, tmp_path: Path) -> None:
    source = read_source(recorded)
    file = raw_path(recorded, "left", 0)
    whole = file.read_bytes()
    file.unlink()
    assert raw_touch(source, source.episodes[0], "left") is None
    file.write_bytes(whole[: len(whole) // 2])
    read = raw_touch(source, source.episodes[0], "left")
    assert read is not None
    with pytest.raises(DatasetError, match="episode_000000"):
        list(read)
    file.write_bytes(whole)


def test_the_page_has_a_row_for_each(recorded: Path, tmp_path: Path) -> None:
    assert main([f"root={recorded}", "episode=1", f"out={tmp_path / 'kept'}"]) == 0
    file = raw_path(recorded, "left", 1)
    file.rename(file.with_suffix(".away"))
    assert main([f"root={recorded}", "episode=1", f"out={tmp_path / 'away'}", "verify=off"]) == 0
    file.with_suffix(".away").rename(file)
    kept, away = (cv2.imread(str(tmp_path / f / "episode_1_moments.png")) for f in ("kept", "away"))
    assert kept is not None and away is not None and len(kept) > len(away)
