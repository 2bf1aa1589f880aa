"""The demo at its smallest: every stage runs, a page of text comes out, the rest is in its log;
what a view takes."""

import os
import sys

import pytest

from uniforce_cli import demo, record, view
from uniforce_datasets.view_plan import EpisodeFacts

CLEAN, EVENT, FAILED, ABORTED = (
    (True, "success"),
    (False, "success"),
    (False, "residual"),
    (False, "aborted"),
)


class SeenEnoughError(Exception):
    """Ends the demo where a test has seen enough."""


def test_it_learns_from_every_demo_that_wiped_the_board(tmp_path, monkeypatch):
    """Of three demos all may have an event, and the demo ended there."""
    asked = []

    def stop(config):
        asked.append(config)
        raise SeenEnoughError

    monkeypatch.setattr(record, "record", lambda config: None)
    monkeypatch.setattr(view, "make_view", stop)
    with pytest.raises(SeenEnoughError):
        demo.run(demo.DemoConfig(out=str(tmp_path / "demo")))
    assert asked[0].keep_events and not asked[0].keep_failures


def test_a_failed_step_shows_the_end_of_the_log_and_where_it_is(tmp_path, monkeypatch, capfd):
    def fail(config):
        sys.stdout.write("".join(f"line {number}\n" for number in range(100)))
        sys.stderr.write("of a library\n")
        os.write(2, b"of a child process\n")
        raise SeenEnoughError

    monkeypatch.setattr(record, "record", fail)
    assert demo.main([f"out={tmp_path / 'demo'}"]) == 70
    said, log = capfd.readouterr().out, tmp_path / "demo" / demo.LOG
    assert str(log) in said and "line 99" in said and "line 1\n" not in said
    assert {"line 1", "of a child process"} <= set(log.read_text().splitlines())
    assert "of a library" in log.read_text()


@pytest.mark.timeout(900)
@pytest.mark.thorough
def test_the_smallest_demo_prints_less_than_forty_lines(tmp_path, capfd):
    out = tmp_path / "demo"
    assert demo.main(["episodes=1", "train_steps=1", "rollouts=1", "level=easy", f"out={out}"]) == 0
    said, warned = capfd.readouterr()
    assert len((said + warned).splitlines()) <= 40
    assert "| uSkin |" in said and "Done in" in said and str(out / demo.LOG) in said
    assert "Creating policy" in (out / demo.LOG).read_text()  # LeRobot's own words
    for page in (out / "show" / "episode_0.html", out / "sensors.html"):
        assert page.is_file()
        assert str(page) in said
    assert (out / "wiping.json").is_file()


@pytest.mark.parametrize(
    "settings, taken",
    [
        ({}, [CLEAN, EVENT]),
        ({"keep_events": False}, [CLEAN]),
        ({"keep_failures": True}, [CLEAN, EVENT, FAILED, ABORTED]),
    ],
)
def test_clean_demos_always_others_when_asked_for(settings, taken):
    def facts(success, outcome):
        return EpisodeFacts("demos", 0, 300, "wipe", success, outcome, 0, "gelsight", "tactip")

    every = (CLEAN, EVENT, FAILED, ABORTED)
    assert [end for end in every if view.chosen(facts(*end), view.ViewConfig(**settings))] == taken
