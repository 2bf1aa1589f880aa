"""A page that plays films of one scene side by side, one per sensor."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import av

from uniforce_cli.dataset_sheet import TEMPLATES
from uniforce_cli.episode_films import encoded
from uniforce_vtla.evaluation.arms import EpisodeRow
from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.film import FILM_HZ

QUALITY = 70  # of WebP, up to 100


@dataclass(frozen=True)
class SensorFilm:
    """Film of one rollout."""

    sensor: str  # in words
    video: Path  # of ``uniforce score``; absent where the sensor was refused at its first frame
    row: EpisodeRow
    tally: str  # how often all its rollouts ended well, in words

    @property
    def ending(self) -> str:
        """How the rollout ended."""
        if not self.video.exists():
            return "stopped before it began; the demo's log says why"
        words = [self.row.outcome.replace("_", " ")]
        if self.row.outcome == "success":
            words = ["clean wipe" if self.row.clean else "wiped, not clean"]
        if self.row.slippage:
            words.append("slip")
        if self.row.excess_force:
            words.append("too much force")
        words.append(f"{self.row.in_band_share:.0%} of the way within the band")
        return ", ".join(words)


def write_sensors_page(films: Sequence[SensorFilm], path: Path) -> Path:
    """Write the page with all pictures in it, the trained sensor's film first."""
    pictures = [_frames(film.video) for film in films]
    text = TEMPLATES.get_template("sensors_page.html").render(
        films=films,
        pictures=pictures,
        last=max(0, *(len(film) - 1 for film in pictures)),
        hz=FILM_HZ,
        band_N=ScoreLimits().band_N,
    )
    path.write_text(text)
    return path


def _frames(video: Path) -> list[str]:
    """Return base64 WebP of each frame; none of an episode that never began."""
    found: list[str] = []
    if not video.exists():
        return found
    with av.open(str(video)) as container:
        for frame in container.decode(video=0):
            picture = encoded(frame.to_ndarray(format="rgb24"), QUALITY)
            found.append(b64encode(picture).decode())
    return found
