"""Whole sessions in any order of commands, stops and faults: after a stop nothing moves unasked.

The session's own code runs in a thread of its own, which asks what a person does at every tick;
hypothesis answers. Between sessions the robot is driven directly, as LeRobot's loop drives it for
a policy.
"""

import json
import logging
import multiprocessing
import os
import sys
import threading
import traceback
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar
from unittest import mock

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import Phase as Stage
from hypothesis import strategies as st
from hypothesis.errors import FlakyStrategyDefinition
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from benchmarks.ledger import update
from benchmarks.trust.stop_world import SimWorld, StandInWorld, WIDEST_m, World
from uniforce_cli.boundary import command
from uniforce_robots.recorder import episode as episode_module
from uniforce_robots.recorder import session as session_module
from uniforce_robots.recorder.episode import Parts
from uniforce_robots.recorder.faults import Interrupts
from uniforce_robots.recorder.operators import Event, KeyOperator, LiveView, Phase
from uniforce_robots.recorder.rig import Observation, Rig, RigFacts
from uniforce_robots.recorder.session import RecordingSession, SessionEnd, SessionSettings
from uniforce_robots.recorder.steering import Steering
from uniforce_robots.recorder.ticker import Ticker
from uniforce_robots.sensors.faults import LostSensorError
from uniforce_robots.teleop import (
    UniforceHandGuide,
    UniforceHandGuideConfig,
    UniforceKeyboard,
    UniforceKeyboardConfig,
    UniforceSpaceMouse,
    UniforceSpaceMouseConfig,
    UniforceTeleoperator,
)
from uniforce_robots.teleop.keyboard import KEYS, PULSE_S, TerminalKeys
from uniforce_vtla.errors import RobotError, SensorError, UniForceError
from uniforce_vtla.keys import AXES

WORKERS = 2
WORLDS = ("simulated", "over_the_standin")
FPS = 30
STEPS = 30  # of a session, at most
FULL = 350.0  # counts of a cap at full deflection
REFERENCE_ticks = 6  # for which references are taken
SAVING_ticks = 9  # for which an episode is saved; its encoders may take much longer
TEXT = "abcdefghijklmnopqrstuvwxyz"
COMMANDS = ("space", "esc", "enter", "y", "f", "g", "x", "r", "v", "t", "T", "V", "backspace")
ROBOT_STOPS = ("reflex", "user_stop")  # which end no loop
ORDERED_STOPS = (*ROBOT_STOPS, "guide", "jump", "nan")
STOPS = ("esc", "t", "T")  # commands that hold, whatever the phase
TELEOPS: dict[str, Callable[[], UniforceTeleoperator]] = {
    "keyboard": lambda: UniforceKeyboard(UniforceKeyboardConfig()),
    "hand_guide": lambda: UniforceHandGuide(UniforceHandGuideConfig()),
    "spacemouse": lambda: UniforceSpaceMouse(UniforceSpaceMouseConfig()),
}


class Cap:
    """A SpaceMouse's reader without a device."""

    def __init__(self) -> None:
        self.state: np.ndarray = np.zeros(8)
        self.reconnects = 0
        self.is_running = self.is_plugged = True

    def start(self) -> None:
        """Do nothing."""

    stop = start

    def newest(self, max_age_ms: float) -> Any:
        """Return the newest state; raises LostSensorError: unplugged."""
        if not self.is_plugged:
            raise LostSensorError("spacemouse: expected a device, got none.")
        return SimpleNamespace(raw=self.state, age_ms=0.0)


def pass_ticks(ticks: int, world: World, meanwhile: Callable[[], None]) -> None:
    """Let time pass while the session does something else; the person acts at each tick."""
    for _ in range(ticks):
        meanwhile()
        world.sleep(1 / FPS)


class SessionRig(Rig):
    """The robot as a rig without cameras or fingers, whose observation may fail."""

    def __init__(self, world: World) -> None:
        self.facts = RigFacts(
            "sessions", FPS, {"left": "tactip", "right": "tactip"}, {}, paced=True
        )
        self._world = world
        self.fault: Exception | None = None
        self.stall_ticks = 0  # for which the next observation waits
        # what the person does each tick of a stall
        self.meanwhile: Callable[[], None] = lambda: None

    def now_s(self) -> float:
        """Return the world's time."""
        return self._world.clock()

    def axes(self) -> np.ndarray:
        """(5,) where it is."""
        return self._world.robot.measured()

    def connect(self) -> None:
        """Do nothing: the robot is connected."""

    close = connect

    def begin_episode(self, seed: int) -> None:
        """Take as long as references take, while nothing may move."""
        self._world.watch.stopped("references", self._world.clock(), at_once=True)
        pass_ticks(REFERENCE_ticks, self._world, self.meanwhile)

    def observe(self) -> Observation:
        """Return the axes, late or not at all where that was asked for."""
        if self.stall_ticks:
            self._world.watch.stopped("a stall", self._world.clock())
        pass_ticks(self.stall_ticks, self._world, self.meanwhile)
        self.stall_ticks = 0
        if self.fault is not None:
            raise self.fault
        return Observation(self.now_s(), self.axes(), {}, {})

    def act(self, action: np.ndarray) -> np.ndarray:
        """Send an action."""
        sent = self._world.robot.send_action(dict(zip(AXES, action.tolist(), strict=True)))
        return np.array([sent[axis] for axis in AXES])

    def hold(self) -> None:
        """Rest."""
        self._world.robot.hold()

    def recover(self) -> None:
        """Clear a fault."""
        self._world.robot.recover()

    def summary(self) -> dict[str, Any]:
        """Return nothing."""
        return {}


class Store:
    """A recorder that only counts, and takes its time to save."""

    num_frames = num_episodes = total_frames = 0

    def __init__(self, world: World, meanwhile: Callable[[], None]) -> None:
        self._world, self._meanwhile = world, meanwhile

    def add(self, row: Any, task: str, raw: Any = None) -> None:
        """Take a row."""
        self.num_frames += 1

    def save(self, *outcome: Any, **more: Any) -> None:
        """Forget the rows, after a while in which nothing may move."""
        self.num_frames = 0
        self._world.watch.stopped("an episode's end", self._world.clock(), at_once=True)
        pass_ticks(SAVING_ticks, self._world, self._meanwhile)

    discard = save


class Person(KeyOperator):
    """Gives the other thread the word at each tick, holds keys down, notes changes of phase."""

    def __init__(self, world: World, keys: TerminalKeys) -> None:
        super().__init__(keys)
        self._world, self.phase = world, Phase.WAITING
        self.held: dict[str, int] = {}  # ticks for which each key stays down
        self.pressed_s: dict[str, float] = {}  # when each was pressed last
        self.ticks = 0
        self.word, self.answer = threading.Semaphore(0), threading.Semaphore(0)

    def poll(self, phase: Phase) -> list[Event]:
        """Let the other thread act when its ticks are over; return what was ordered."""
        if phase is not self.phase:
            why = f"{self.phase.value} became {phase.value}"
            self._world.watch.stopped(why, self._world.clock(), at_once=True)
        self.phase = phase
        if self._world.paced:
            self._world.look()
        if self.ticks <= 0:
            self.word.release()
            self.answer.acquire()
        self.ticks -= 1
        self.repeat_held()
        return super().poll(phase)

    def repeat_held(self) -> None:
        """Press what is held down once more, as a terminal does."""
        for key in [key for key, left in self.held.items() if left > 0]:
            self._keys.press(key)
            self.pressed_s[key] = self._world.clock()
            self.held[key] -= 1

    def wait(self, ticks: int) -> None:
        """Let the session run for some ticks; called by the other thread."""
        self.ticks = ticks
        self.answer.release()
        self.word.acquire()


class Session:
    """A recording session in its thread, driven by one of our teleoperators."""

    def __init__(self, world: World, teleop: str) -> None:
        self.world, self.rig = world, SessionRig(world)
        self.teleop = TELEOPS[teleop]()
        self.teleop.clock = world.clock
        self.cap: Cap | None = None
        if isinstance(self.teleop, UniforceKeyboard):
            keys = self.teleop.keys
        else:
            keys = TerminalKeys({}, world.clock)
            self.teleop.device = self.cap = Cap()
        keys.start = lambda: setattr(keys, "_listener", None)  # type: ignore[method-assign]
        self.keys, self.person = keys, Person(world, keys)
        self.rig.meanwhile = self.person.repeat_held
        self.interrupts = Interrupts()
        self.end: SessionEnd | None = None
        self.crash: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        self.person.word.acquire()

    def _run(self) -> None:
        time = SimpleNamespace(
            monotonic=self.world.clock,
            perf_counter=self.world.clock,
            time=self.world.clock,
            sleep=self.world.sleep,
        )
        ticker = partial(Ticker, clock=self.world.clock, sleep=self.world.sleep)
        disk: Any = SimpleNamespace(before_episode=lambda *_: "room", check=lambda *_: 0.0)
        patches: list[Any] = [
            mock.patch.object(episode_module, "Ticker", ticker),
            mock.patch.object(episode_module, "time", time),
            mock.patch.object(session_module, "time", time),
            mock.patch.object(episode_module, "make_row", lambda *_: {}),
            mock.patch.object(UniforceKeyboard, "is_connected", property(lambda _: True)),
        ]
        with ExitStack() as stack:
            for patch in patches:
                stack.enter_context(patch)
            view = LiveView(None)
            steering = Steering(self.teleop)
            store: Any = Store(self.world, self.person.repeat_held)
            parts = Parts(self.rig, steering, self.person, store, disk, view, self.interrupts)
            wanted = SessionSettings(
                episodes=1000, prompts=("wipe",), episode_s=4.0, late_share=1.0
            )
            try:
                self.end = RecordingSession(parts, wanted, 0, 0).run()
            except BaseException as error:  # a session that dies is what is looked for
                self.crash = error
        self.world.robot.hold()
        self.person.word.release()

    @property
    def is_over(self) -> bool:
        """Whether the session has ended."""
        return self.end is not None or self.crash is not None

    @property
    def is_live(self) -> bool:
        """Whether what a person steers now is to move the robot."""
        phase, note = self.person.phase, self.person.note
        return phase in (Phase.WAITING, Phase.RUNNING) and note is None and not self.keys.is_text

    def finish(self) -> None:
        """End the session as Ctrl-C does."""
        while not self.is_over:
            self.interrupts.count = 1
            self.person.wait(1)
        self._thread.join()


TICKS = st.integers(1, 20)


class StopMachine(RuleBasedStateMachine):
    """A person, a policy and a robot; ``make_world`` is set by who runs it."""

    make_world: Callable[[], World] = SimWorld
    counts: ClassVar[Counter[str]] = Counter()
    wrongs: ClassVar[list[str]] = []  # what moved, or died, in any session so far

    def __init__(self) -> None:
        super().__init__()
        self.session: Session | None = None
        self.last_wish: np.ndarray | None = None  # of a policy's loop
        self.steps = 0

    @initialize(teleop=st.sampled_from([*sorted(TELEOPS), "", ""]))
    def begin(self, teleop: str) -> None:
        """Begin with a person's session, or with a policy's loop."""
        self.world = type(self).make_world()
        self.watch = self.world.watch
        self.robot = self.world.robot
        self._stop("connecting")
        self.robot.connect()
        self.wish_m = self.robot.measured()
        if teleop:
            self.session = Session(self.world, teleop)

    def teardown(self) -> None:
        if not hasattr(self, "world"):
            return
        try:
            if self.session is not None:
                self.session.finish()
            self._stop("the end")
            self.robot.disconnect()
            self.world.sleep(0.5)
        finally:
            self.world.close()
        counts = type(self).counts
        counts["sessions"] += self.steps >= 20
        counts["steps"] += self.steps
        counts["moved"] += self.watch.moves > 0
        counts["violations"] += len(self.watch.violations)
        type(self).wrongs.extend(self.watch.violations)
        assert not self.watch.violations, self.watch.violations[0]

    @invariant()
    def nothing_moved_after_a_stop(self) -> None:
        if not hasattr(self, "watch"):
            return
        self.steps += 1
        session = self.session
        if session is not None and session.crash is not None:
            type(self).wrongs.append(f"the session died of {session.crash!r}")
            raise AssertionError("the session died") from session.crash
        assert not self.watch.violations, self.watch.violations[0]
        if session is not None and session.is_over:
            self.session = None

    def _stop(self, why: str, at_once: bool = False) -> None:
        self.watch.stopped(why, self.world.clock(), at_once)

    def _wait(self, ticks: int) -> None:
        if self.session is not None:
            self.session.person.wait(ticks)
        else:
            self.world.sleep(ticks / FPS)

    def _mend(self) -> None:
        for mend in ("release", "honest", "unblock"):
            if mend in self.world.orders:
                self.world.order(mend)

    @property
    def _live(self) -> Session:
        assert self.session is not None
        return self.session

    def _move(self, key: str, axis: int, down: int, before: int) -> None:
        """Hold a key down, or push the cap, for some ticks."""
        if self._live.cap is None:
            self.steer(key, down, before)
        else:
            self.push(axis, 1.0, before)

    def _get_well(self) -> None:
        """Mend and recover where something was wrong."""
        if not self._is_well:
            self._mend()
            self.recover(3)

    @property
    def _is_well(self) -> bool:
        robot = self.robot
        return robot._stream is not None and robot._fault is None and robot._stream.fault is None

    # --- a person at the keys and the cap ---

    @precondition(lambda self: self.session)
    @rule(key=st.sampled_from(sorted(KEYS)), down=st.integers(1, 40), ticks=TICKS)
    def steer(self, key: str, down: int, ticks: int) -> None:
        """Hold a steering key down for a while."""
        session = self._live
        now_s = self.world.clock()
        free = session.person.held.get(key, 0) <= 0
        rested = now_s >= session.person.pressed_s.get(key, 0.0) + PULSE_S
        if free and rested and session.is_live and self._is_well:
            self.watch.wished()
        session.person.held[key] = down
        self._wait(ticks)

    @precondition(lambda self: self.session)
    @rule(key=st.sampled_from(COMMANDS), ticks=TICKS)
    def order(self, key: str, ticks: int) -> None:
        """Press a key of the session."""
        session = self._live
        if key in STOPS and not session.keys.is_text:
            self._stop(f"{key} in {session.person.phase.value}", at_once=True)
        session.keys.press(key)
        self._wait(ticks)

    @precondition(lambda self: self.session)
    @rule(text=st.text(TEXT, min_size=1, max_size=6))
    def type_a_note(self, text: str) -> None:
        """Begin a note and type it, a letter a tick."""
        session = self._live
        if not session.keys.is_text:
            self._stop(f"a note in {session.person.phase.value}", at_once=True)
        for key in ("t", *text):
            session.keys.press(key)
            if not session.is_over:
                self._wait(1)

    @precondition(lambda self: self.session and self.session.cap)
    @rule(axis=st.integers(0, 7), share=st.sampled_from([-1.0, 0.4, 1.0]), ticks=TICKS)
    def push(self, axis: int, share: float, ticks: int) -> None:
        """Push the cap or a button."""
        session = self._live
        assert session.cap is not None
        is_at_rest = not session.cap.state.any()
        if is_at_rest and session.is_live and self._is_well and session.cap.is_plugged:
            self.watch.wished()
        session.cap.state[axis] = share * FULL if axis < 6 else 1.0
        self._wait(ticks)

    @precondition(lambda self: self.session and self.session.cap)
    @rule(ticks=TICKS)
    def let_go(self, ticks: int) -> None:
        """Let go of the cap."""
        assert self._live.cap is not None
        self._live.cap.state[:] = 0
        self._wait(ticks)

    @precondition(lambda self: self.session and self.session.cap)
    @rule(gone=st.integers(0, 10), ticks=TICKS)
    def replug(self, gone: int, ticks: int) -> None:
        """Unplug the cap and plug it in again, pushed or not; ``gone`` ticks later."""
        session = self._live
        assert session.cap is not None
        self._stop("an unplugged cap")
        session.cap.is_plugged = False
        if gone:
            self._wait(gone)
        session.cap.is_plugged = True
        session.cap.reconnects += 1
        if not session.is_over:
            self._wait(ticks)

    @precondition(lambda self: self.session and self.session.cap)
    @rule(axis=st.integers(0, 2), share=st.sampled_from([-1.0, 1.0]), before=st.integers(3, 6))
    def replug_unseen(self, axis: int, share: float, before: int) -> None:
        """Let a pushed cap lose its plug and get it back between two ticks."""
        self.let_go(2)
        self.push(axis, share, before)
        if self.session is not None and not self.session.is_over:
            self.replug(0, 20)

    # --- the robot, its sensors and its computer ---

    @rule(data=st.data(), ticks=TICKS)
    def break_or_mend(self, data: st.DataObject, ticks: int) -> None:
        """Stop, lead, block or mend the arm, or let it say what can't be."""
        what = data.draw(st.sampled_from(self.world.orders))
        if what not in ("release", "honest", "block", "unblock"):
            self._stop(what)
        self.world.order(what)
        self._wait(ticks)

    @rule(width_m=st.sampled_from([0.0, 0.015, 0.03, 0.055]), ticks=TICKS)
    def put_between_the_fingers(self, width_m: float, ticks: int) -> None:
        """Put something between the fingers, or take it away."""
        self.world.hold_object(width_m)
        self._wait(ticks)

    @precondition(lambda self: not self._is_well)
    @rule(by_rad=st.sampled_from([-0.3, -0.08, 0.08, 0.3]), ticks=TICKS)
    def tilt(self, by_rad: float, ticks: int) -> None:
        """Tilt the hand by hand while the arm is stopped."""
        self._stop("tilted by hand")
        self.world.tilt(by_rad)
        self._wait(ticks)

    @precondition(lambda self: self.session)
    @rule(error=st.sampled_from([SensorError("frozen"), KeyError("oh"), None]), ticks=TICKS)
    def see(self, error: Exception | None, ticks: int) -> None:
        """Let the observation fail from now on, or be well again."""
        if error is not None and self._live.person.phase is Phase.RUNNING:
            self._stop("a sensor")
        self._live.rig.fault = error
        self._wait(ticks)

    @precondition(lambda self: self.session)
    @rule(long=st.sampled_from([8, 15, 30]), ticks=TICKS)
    def stall(self, long: int, ticks: int) -> None:
        """Let the next observation take longer than the robot waits for an action."""
        self._live.rig.stall_ticks = long
        self._wait(ticks)

    @precondition(lambda self: self.session)
    @rule(
        data=st.data(),
        down=st.integers(3, 30),
        before=st.integers(2, 15),
        after=st.integers(15, 25),
    )
    def move_and_stop(self, data: st.DataObject, down: int, before: int, after: int) -> None:
        """Move, most of all the fingers, stop on the way in any manner, and let time pass."""
        session = self._live
        if session.cap is None:
            self.steer(data.draw(st.sampled_from(["p", "o", "w", "s", "c", "j"])), down, before)
        else:
            self.push(data.draw(st.sampled_from([0, 1, 2, 5, 6, 7])), 1.0, before)
        orders = [order for order in self.world.orders if order in ORDERED_STOPS]
        how = data.draw(
            st.sampled_from(["space", "esc", "t", "y", "x", "stall", "sensor", "replug", *orders])
        )
        if session.is_over:
            return
        if how in orders:
            self._stop(how)
            self.world.order(how)
        elif how == "stall":
            session.rig.stall_ticks = 15
        elif how == "sensor":
            self.see(SensorError("lost"), 1)
            session.rig.fault = None
        elif how == "replug" and session.cap is not None:
            self.replug(data.draw(st.sampled_from([0, 2])), 1)
        else:
            self.order(how if len(how) == 1 or how in COMMANDS else "space", 1)
        if not session.is_over:
            self._wait(after)

    @precondition(lambda self: self.session and self.session.person.phase is Phase.WAITING)
    @rule(key=st.sampled_from(["w", "s", "c", "j"]), before=st.integers(4, 12))
    def begin_on_the_way(self, key: str, before: int) -> None:
        """Begin an episode while the arm is on its way to where that one starts."""
        session = self._live
        self._move(key, 0, before + 2, before)
        if not session.is_over:
            self.order("space", 12)

    @precondition(lambda self: self.session)
    @rule(
        key=st.sampled_from(["p", "o", "w", "s", "c", "j"]),
        before=st.integers(3, 10),
        between=st.integers(1, 4),
    )
    def pause_and_go_on(self, key: str, before: int, between: int) -> None:
        """Pause for a moment and go on while the key or cap is held: nobody wishes anew."""
        session = self._live
        if session.person.phase is Phase.WAITING:
            session.keys.press("space")
            self._wait(2)
        if session.is_over:
            return
        self._move(key, 0, 60, before)
        for ticks in (between, 12):
            if not session.is_over and session.person.phase in (Phase.RUNNING, Phase.PAUSED):
                self._stop("a short pause", at_once=True)
                session.keys.press("space")
                self._wait(ticks)

    @precondition(lambda self: self.session)
    @rule(ticks=TICKS)
    def revive(self, ticks: int) -> None:
        """Mend all that is broken and bring the session back to where it runs, with no new wish."""
        session = self._live
        self._mend()
        session.rig.fault = None
        if session.keys.is_text:
            session.keys.press("enter")
        self._wait(1)
        last = {Phase.JUDGING: "x", Phase.WAITING: "v"}
        for _ in range(2):
            key = last.get(session.person.phase, "")
            if key and not session.is_over:
                session.keys.press(key)
                self._wait(2)
        if session.person.phase is not Phase.RUNNING and not session.is_over:
            session.keys.press("space")
            self._wait(ticks)

    # --- between sessions: a policy's loop ---

    @precondition(lambda self: self.session)
    @rule()
    def end_session(self) -> None:
        """End the session by Ctrl-C."""
        self._stop("Ctrl-C")
        self._live.finish()
        self.session = None

    @precondition(lambda self: not self.session)
    @rule(teleop=st.sampled_from(sorted(TELEOPS)))
    def begin_session(self, teleop: str) -> None:
        """Begin another session with the robot as it is."""
        self.robot.hold()  # as whoever drove it before does at its end
        self._stop("a new session")
        self.session = Session(self.world, teleop)

    @precondition(lambda self: not self.session)
    @rule(
        way=st.lists(st.sampled_from([-0.1, -0.01, 0.0, 0.05]), min_size=4, max_size=4),
        width_m=st.sampled_from([0.0, 0.02, 0.05, 0.08]),
        ticks=TICKS,
    )
    def act(self, way: list[float], width_m: float, ticks: int) -> None:
        """Send one absolute target for some ticks, as a policy does; a refused one is no wish."""
        try:
            wish = np.array([*self.robot.measured()[:4] + way, width_m])
        except RobotError:
            return
        if self._is_well:
            self.watch.wished()
        self.last_wish = wish
        self._send(wish, ticks)

    @precondition(lambda self: not self.session)
    @rule(ticks=TICKS)
    def stay(self, ticks: int) -> None:
        """Send where the robot is."""
        try:
            self._send(self.robot.measured(), ticks)
        except RobotError:
            return

    def _send(self, wish: np.ndarray, ticks: int) -> None:
        for _ in range(ticks):
            try:
                self.robot.send_action(dict(zip(AXES, wish.tolist(), strict=True)))
            except RobotError:  # a loop that goes on regardless: what it sends is no new wish
                self._stop("a refused action")
            self.world.sleep(1 / FPS)

    @precondition(lambda self: not self.session)
    @rule(by_rad=st.sampled_from([-0.13, 0.13]), way_m=st.sampled_from([-0.01, 0.01, 0.05]))
    def tilt_and_move(self, by_rad: float, way_m: float) -> None:
        """Lead the hand until it is tilted, let go, and wish it somewhere near."""
        self._stop("led by hand")
        self.world.order("guide")
        self.world.sleep(0.1)
        self.world.tilt(by_rad)
        self._mend()
        self.recover(3)
        self.act([way_m, 0.0, 0.0, 0.0], WIDEST_m, 20)

    @precondition(lambda self: not self.session)
    @rule(
        width_m=st.sampled_from([0.0, 0.02, 0.08]),
        how=st.sampled_from(["hold", "nan", "no action", "silence", *ROBOT_STOPS]),
        mends=st.booleans(),
    )
    def act_and_stop(self, width_m: float, how: str, mends: bool) -> None:
        """Move arm and fingers, stop on the way, perhaps recover, and wish to stay.

        After a fault, or the robot's own stop, the loop first goes on with what it wished before.
        """
        self._get_well()
        self.act([0.05, 0.0, -0.03, 0.1], width_m, 8)
        if how in ROBOT_STOPS:
            self._stop(how)
            self.world.order(how)
        else:
            self.stop(how, 15 if how == "silence" else 3)
        if how not in ("hold", "silence") and self.last_wish is not None:
            self._send(self.last_wish, 20)
        if mends:
            self.recover(10)
        self.stay(10)

    @precondition(lambda self: not self.session)
    @rule(how=st.sampled_from(["hold", "nan", "no action", "silence"]), ticks=TICKS)
    def stop(self, how: str, ticks: int) -> None:
        """Stop by each way a loop can, silence included."""
        self._stop(how, at_once=how == "hold")
        if how == "hold":
            self.robot.hold()
        elif how != "silence":
            action = None if how == "no action" else dict.fromkeys(AXES, np.nan)
            with suppress(RobotError):
                self.robot.send_action(action)  # type: ignore[arg-type]
        self.world.sleep(0.3 + ticks / FPS)

    @precondition(lambda self: not self.session)
    @rule(ticks=TICKS)
    def recover(self, ticks: int) -> None:
        """Recover on an operator's word."""
        self._stop("recover")
        with suppress(UniForceError):
            self.robot.recover()
        self.world.sleep(ticks / FPS)

    @precondition(lambda self: not self.session)
    @rule(ticks=TICKS)
    def reconnect(self, ticks: int) -> None:
        """Disconnect, wait, and connect again."""
        self._stop("reconnecting")
        self.robot.disconnect()
        self.world.sleep(ticks / FPS)
        with suppress(UniForceError):
            self.robot.connect()


def explore(
    times: int, make_world: Callable[[], World], steps: int = STEPS, at_random: bool = False
) -> Counter[str]:
    """Run sessions until ``times`` of at least 20 steps were run; return the counts.

    The same sessions each time, unless ``at_random``. In real time no session can be repeated:
    hypothesis, which finds that out now and then, begins anew, and what went wrong is kept.

    Raises AssertionError: something moved, or a session died.
    """
    counts: Counter[str] = Counter()
    wrongs: list[str] = []
    while counts["sessions"] < times:
        kept = {"make_world": staticmethod(make_world), "counts": counts, "wrongs": wrongs}
        machine = type("Stops", (StopMachine,), kept)
        wanted = settings(
            max_examples=max(times - counts["sessions"], 5),
            stateful_step_count=steps,
            deadline=None,
            database=None,
            derandomize=not at_random,
            phases=(Stage.generate,),
            suppress_health_check=list(HealthCheck),
        )
        with suppress(FlakyStrategyDefinition):
            run_state_machine_as_test(machine, settings=wanted)  # type: ignore[arg-type]
        if wrongs:
            raise AssertionError(wrongs[0])
    return counts


@dataclass
class SessionsConfig:
    """Drive whole sessions in any order, on a set clock and over the stand-in; count what moved.

    Example: python -m benchmarks.trust.stop_sessions times=2000 out=docs/results/trust.json
    """

    # sessions of at least 20 steps on the set clock; 0: none, what the file says of them stays
    times: int = 2000
    real: int = 100  # the same over the stand-in, in real time
    out: str = "outputs/trust.json"  # the result file; only its key ``sessions`` changes


def _explore_simulated(times: int) -> Counter[str]:
    logging.disable(logging.CRITICAL)
    return explore(times, SimWorld, at_random=True)


def _explore_real(times: int) -> Counter[str]:
    logging.disable(logging.CRITICAL)
    address = f"127.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250}.3"
    return explore(times, lambda: StandInWorld(address), steps=24, at_random=True)


def store(path: Path, found: dict[str, Any]) -> Path:
    """Put what was found beside what stands under ``sessions``; totals are of both worlds."""
    before = json.loads(path.read_text()).get("sessions", {}) if path.is_file() else {}
    whole = before | found
    for total in ("tried", "steps", "violations"):
        whole[total] = sum(whole[world][total] for world in WORLDS if world in whole)
    return update(path, "sessions", whole)


def _store(path: Path, world: str, counts: Counter[str]) -> None:
    """Store a world's line; sessions of fewer than 20 steps aren't counted as tried."""
    line = {"tried": counts["sessions"]}
    for name in ("moved", "steps", "violations"):
        line[name] = counts[name]
    print(f"{world}: {line}; written to {store(path, {world: line})}", flush=True)


@command(SessionsConfig)
def main(config: SessionsConfig) -> int:
    """Run both, write the counts of each as soon as it is done; 1 where anything moved."""
    simulated, real = WORLDS
    try:
        if config.real:
            _store(Path(config.out), real, _explore_real(config.real))
        if config.times:
            shares = [config.times // WORKERS] * WORKERS
            spawn = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(WORKERS, mp_context=spawn) as pool:
                counts = sum(pool.map(_explore_simulated, shares), Counter[str]())
            _store(Path(config.out), simulated, counts)
    except AssertionError:  # something moved: hypothesis says what was done before
        traceback.print_exc()
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
