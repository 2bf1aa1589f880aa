"""Looking at a recording: a page that needs nothing, and what it may claim."""

import base64
import json
import time
from html.parser import HTMLParser
from itertools import combinations

import cv2
import numpy as np
import pytest
from calibration_samples import save_calibration
from headless_browser import open_browser

from uniforce_cli import estimate
from uniforce_cli.dataset_sheet import write_sheet
from uniforce_cli.episode_films import Films, encoded
from uniforce_cli.recorded_episode import (
    EpisodeForces,
    RecordingForces,
    finger_sensors,
    raw_touch,
    summarise_episode,
)
from uniforce_cli.show import main
from uniforce_datasets.features import flat_column
from uniforce_datasets.raw_video import raw_path
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.source import read_source
from uniforce_datasets.synthetic import FPS, record_synthetic, synthetic_frame
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.evaluation.episode_summary import EpisodeSummary, KeyFrame, find_key_frames
from uniforce_vtla.evaluation.finger_estimates import estimate_events
from uniforce_vtla.keys import counts_key
from uniforce_vtla.tokenizer import Tokenizer

FRAMES = 8
RATE = 30


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record_synthetic(tmp_path_factory.mktemp("show") / "dots", 2, FRAMES)


class Sources(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []
        self.tags = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.found += [value for name, value in attrs if name in ("src", "href") and value]


def test_a_page_holds_its_pictures(recorded, tmp_path):
    assert main([f"root={recorded}", "episode=1", f"out={tmp_path}"]) == 0
    page = (tmp_path / "episode_1.html").read_text()
    parser = Sources()
    parser.feed(page)
    (source,) = parser.found  # and nothing from a network
    png = base64.b64decode(source.removeprefix("data:image/png;base64,"), validate=True)
    assert cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).std() > 10
    assert "wipe the dots" in page and "tactip" in page and "Estimated" in page
    content = json.loads((tmp_path / "episode_1.json").read_text())
    assert content["facts"]["left sensor"] == "gelsight" and "force_mae_N" in content


def test_an_episode_that_is_too_short_costs_the_others_nothing(recorded, tmp_path, capsys):
    assert estimate.main([f"root={recorded}", "pad_friction=0.6,0.6", f"out={tmp_path}"]) == 0
    said = capsys.readouterr().out
    assert "episode 0: not judged, " in said and "episode 1: not judged, " in said
    episodes = json.loads((tmp_path / "estimates.json").read_text())["episodes"]
    assert [row["episode"] for row in episodes] == [0, 1]


def test_latents_are_zero_in_free_air_and_seen_from_the_sensor(recorded):
    recording = RecordingForces(recorded, finger_sensors())
    change = recording.read(recording.source.episodes[0]).change
    left, right = (change[finger] for finger in FINGERS)
    strength = np.linalg.norm(left, axis=-1)  # (n, g, g)
    assert len(left) == FRAMES and strength[0].max() < 1e-5  # the dots start at rest
    assert strength[-1].max() > 0.05
    # both fingers wear the same dots, so that only the mirror tells their latents apart
    assert not np.allclose(left, right, atol=1e-3)


def test_a_head_a_tokenizer_and_a_calibration_may_be_named(recorded, tmp_path, refuses):
    words = [f"root={recorded}", f"out={tmp_path}"]
    strongest_N = []
    nano = ["tokenizer=nano"]
    folder = save_calibration(tmp_path / "map", Tokenizer.from_pretrained("nano"))
    for more in ([], nano, [*nano, "head=uskin"], [*nano, f"right_calibration={folder}"]):
        assert main([*words, *more]) == 0
        content = json.loads((tmp_path / "episode_0.json").read_text())
        strongest_N.append(content["strongest_N"]["right"])
    for first, second in combinations(strongest_N, 2):
        assert first != second
    # the left finger wears a GelSight
    refuses(main, [*words, *nano, f"left_calibration={folder}"], "one of a gelsight")


def test_unknown_episodes_and_half_a_friction_are_refused(recorded, tmp_path, refuses):
    for words, said in (
        (["episode=7"], "from 0 to 1"),
        (["episode=last"], "all, or numbers"),
        (["pad_friction=0.6"], "2 numbers"),
    ):
        refuses(main, [f"root={recorded}", f"out={tmp_path}", *words], said)
    assert not list(tmp_path.iterdir())


def summary_of(title="made up"):
    """Grasp at 1 s, lift at 2 s, press 12 N from 4 to 5 s."""
    time_s = np.arange(6 * RATE) / RATE
    grip = np.where(time_s >= 1, 8.0, 0.0)
    press = np.where((time_s >= 4) & (time_s < 5), 12.0, 0.0)
    finger = np.stack([0 * grip, (0.8 * (time_s >= 2) - press) / 2, grip], axis=1)
    place = np.stack([0 * time_s, 0 * time_s, np.where(time_s >= 2, 0.2, 0.1)], axis=1)
    force = np.stack([finger, finger], axis=1)
    grey = np.full((24, 24, 3), 90, np.uint8)
    named = find_key_frames(force, place[:, 2])
    key_frames = tuple(KeyFrame(*one) for one in named.items())
    change = np.random.default_rng(0).normal(size=(len(time_s), 4, 4, 6)).astype(np.float32)
    return EpisodeSummary(
        title=title,
        time_s=time_s,
        films={"front": [grey] * 3},
        force_N=force,
        true_force_N=None,
        change={"left": change, "right": change},
        key_frames=key_frames,
        found=estimate_events(time_s, force, place, (0.6, 0.6)),
        truth=None,
        judges_slip=True,
    )


def test_key_frames_and_stretches_are_where_things_happen():
    summary = summary_of()
    at_s = {key_frame.name: summary.time_s[key_frame.frame] for key_frame in summary.key_frames}
    assert at_s["grasped"] == 1.0 and at_s["lifted"] == 2.0 and at_s["strongest push"] == 4.0
    assert list(at_s.values()) == sorted(at_s.values())
    stretch = next(s for s in summary.stretches if s.name.startswith("press"))
    assert (summary.time_s[stretch.first], summary.time_s[stretch.end]) == (4.0, 5.0)
    assert "mean press > 10 N" in summary.verdict and not summary.true_verdict


def films_of(frames, name="camera/front"):
    shown = tuple(range(0, frames, 10))
    greys = (np.full((24, 24, 3), 250 * number // frames, np.uint8) for number in shown)
    return Films(shown, {name: tuple(encoded(grey) for grey in greys)})


def made_up_page(folder, title="made up", camera="camera/front"):
    summary = summary_of(title)
    return write_sheet(
        summary, films_of(len(summary.time_s), camera), {"task": "<img src=http://x>"}, folder, "e"
    )


def test_what_a_dataset_says_of_itself_is_text_never_html(tmp_path):
    hostile = "</script><script>x</script>"
    parser = Sources()
    parser.feed(made_up_page(tmp_path, hostile, f'camera/"{hostile}').read_text())
    assert all(source.startswith("data:image/png;base64,") for source in parser.found)
    assert parser.tags.count("script") == 2  # the data and the page's own


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


LOADED = "Promise.all([...document.images].map(i => i.decode().then(() => i.naturalWidth)))"
ROW = "[...document.getElementById('{}').cells].map(cell => cell.textContent)"


def seen(page):
    """Return what the page shows now that the slider may change."""
    found = dict(page.read("[...document.querySelectorAll('#films img')].map(i => [i.id, i.src])"))
    for row in ("estimate", "true"):
        found[row] = page.read(ROW.format(row))
    for name in ("time", "number"):
        found[name] = page.read(f"document.getElementById('{name}').textContent")
    found["cursor"] = page.read("document.getElementById('cursor').getBoundingClientRect().left")
    return found


def test_the_slider_moves_pictures_numbers_time_and_the_line_in_the_plots(
    recorded, tmp_path, browser
):
    assert main([f"root={recorded}", "episode=1", f"out={tmp_path}"]) == 0
    browser.open(tmp_path / "episode_1.html")
    assert all(width > 0 for width in browser.read(LOADED))
    start = seen(browser)
    assert {"camera/front", "camera/wrist", "markers/left", "latent/right"} <= start.keys()
    assert (start["time"], start["number"]) == ("0.00 s", f"frame 0 of {FRAMES - 1}")
    browser.read("document.getElementById('frame').focus()")
    browser.press("ArrowRight", times=FRAMES - 1)
    end = seen(browser)
    assert (end["time"], end["number"]) == ("0.23 s", f"frame {FRAMES - 1} of {FRAMES - 1}")
    assert all(start[what] != end[what] for what in start), "something stood still"
    assert all(width > 0 for width in browser.read(LOADED))
    assert browser.read("document.documentElement.scrollWidth") <= 1280
    assert not browser.complaints


def test_events_and_plots_move_the_slider_and_the_press_is_told_from_its_band(tmp_path, browser):
    browser.open(made_up_page(tmp_path, "<b>made up</b>"))
    assert browser.read("document.title") == "<b>made up</b>"
    press = "(p => [p.textContent, p.className])(document.getElementById('press'))"
    time_s = "parseFloat(document.getElementById('time').textContent)"
    assert browser.read(press) == ["not pressing", "none"]
    browser.click("button.beyond")
    assert browser.read(time_s) == 4.0
    assert browser.read(press) == ["press above 4 to 8 N", "outside"]
    assert browser.read("document.querySelectorAll('[aria-pressed=true]').length") > 0
    browser.click("#plot", 0.999)
    assert browser.read(time_s) == pytest.approx(6.0, abs=0.05)
    browser.click("#plot", 0.5)
    middle = browser.read(time_s)
    assert 2.0 < middle < 5.0
    browser.click("#play")
    end = time.monotonic() + 30
    while browser.read(time_s) == middle and time.monotonic() < end:
        time.sleep(0.05)
    browser.click("#play")
    assert browser.read(time_s) > middle
    assert browser.read("document.getElementById('play').textContent") == "Play"
    assert not browser.complaints


def test_a_browser_complains_of_a_page_that_is_wrong(tmp_path, browser):
    page = tmp_path / "wrong.html"
    page.write_text("<!doctype html><script>missing()</script><img src='nowhere.png'>")
    browser.open(page)
    said = "".join(browser.complaints)
    assert "missing" in said and "nowhere" in said


def test_an_episode_too_short_to_judge_is_shown_all_the_same(recorded, tmp_path, monkeypatch):
    recording = RecordingForces(recorded, finger_sensors())
    episode = recording.source.episodes[0]
    grip = np.tile([0.0, 0.0, 9.0], (FRAMES, 2, 1))
    # lifted for two frames: too short to weigh anything
    height = np.where(np.arange(FRAMES) > 5, 0.2, 0.1)
    place = np.stack([0 * height, 0 * height, height], axis=1)
    forces = EpisodeForces(
        np.arange(FRAMES) / RATE, place, grip, None, recording.read(episode).change
    )
    monkeypatch.setattr(recording, "read", lambda _: forces)
    summary = summarise_episode(recording, episode, None, "short")
    assert summary.found is None and "time after the lift" in summary.verdict[0]
    page = write_sheet(summary, films_of(FRAMES), {}, tmp_path, "e")
    assert "time after the lift" in page.read_text()


RAW_FRAMES = 8
RAW = (48, 64, 3)


@pytest.fixture(scope="module")
def raw_recorded(tmp_path_factory):
    """Return two episodes: raw frames that brighten on the left, counts that grow by 100 a frame on
    the right."""
    root, rng = tmp_path_factory.mktemp("raw") / "dots", np.random.default_rng(0)
    more = {"further": {counts_key("right"): flat_column(48, "int32")}, "raw_shapes": {"left": RAW}}
    with EpisodeRecorder(root, "local/raw", "gelsight", "uskin", FPS, **more) as recorder:
        for number in range(2):
            for step in range(RAW_FRAMES):
                counts = np.full(48, 5000 + 1000 * number + 100 * step, np.int32)
                frame = synthetic_frame(step, rng) | {counts_key("right"): counts}
                recorder.add(frame, "wipe", {"left": np.full(RAW, 20 * step, np.uint8)})
            recorder.save(success=True, outcome="success", seed=number)
    return root


def test_frames_and_counts_are_the_episodes_own(raw_recorded):
    source = read_source(raw_recorded)
    left, right = (raw_touch(source, source.episodes[1], finger) for finger in ("left", "right"))
    brightness = [frame.mean() for frame in left]
    assert np.allclose(brightness, 20 * np.arange(RAW_FRAMES), atol=4)
    # since the first frame: 1,000 counts more there say nothing
    change = [int(picture.max()) for picture in right]
    assert change == [int(100 * step / 4000 * 255) for step in range(RAW_FRAMES)]


def test_what_was_not_kept_is_not_shown_and_what_is_truncated_is_an_error(raw_recorded, tmp_path):
    source = read_source(raw_recorded)
    file = raw_path(raw_recorded, "left", 0)
    whole = file.read_bytes()
    file.unlink()
    assert raw_touch(source, source.episodes[0], "left") is None
    file.write_bytes(whole[: len(whole) // 2])
    read = raw_touch(source, source.episodes[0], "left")
    with pytest.raises(DatasetError, match="episode_000000"):
        list(read)
    file.write_bytes(whole)


def test_the_page_shows_what_was_kept(raw_recorded, tmp_path):
    words = [f"root={raw_recorded}", "episode=1", f"out={tmp_path}"]
    page, file = tmp_path / "episode_1.html", raw_path(raw_recorded, "left", 1)
    assert main(words) == 0
    assert "left finger, raw" in page.read_text()
    away = file.rename(tmp_path / "away")
    assert main([*words, "verify=off"]) == 0
    away.rename(file)
    assert "left finger, raw" not in page.read_text() and "right finger, raw" in page.read_text()


def test_a_demo_as_a_newcomer_records_it_reads_no_force_in_free_air(drawn_demo):
    """Sensors as they are drawn, without a camera; a covered gel's grip is right in the mean
    only."""
    recording = RecordingForces(drawn_demo, finger_sensors())
    forces = recording.read(recording.source.episodes[0])
    is_free = np.linalg.norm(forces.true_force_N, axis=2) < 0.05
    assert np.linalg.norm(forces.force_N, axis=2)[is_free].max() < 1.5
    error_N = abs(forces.force_N - forces.true_force_N)  # (n, 2, 3)
    assert (error_N[~is_free].mean(axis=0)[:2] < 0.5).all()
    held_left, held_right = ~is_free.T
    assert error_N[held_right, 1, 2].mean() < 1.5
    left_N = forces.force_N[held_left, 0, 2].mean()
    assert left_N == pytest.approx(forces.true_force_N[held_left, 0, 2].mean(), abs=2.0)
