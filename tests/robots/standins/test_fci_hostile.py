"""Every fault of the registry, on the wire, through a client of plain sockets; and what is said of it afterwards."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from fci_client import RawArm, RawHand, decode_hand_state, decode_state, hand_request, pull_to, wait_until

from benchmarks.trust.hostile_arm import FAULTS, NONE, HostileStandIn
from uniforce_robots.fr3 import DQ_MAX_rad_s
from uniforce_robots.standins.fci import protocol as p
from uniforce_robots.standins.fci.server import DIED

pytestmark = pytest.mark.slow
SILENCE_s = 0.2  # ten states of the hand, two hundred of the arm
SLOW_MOVE = hand_request(0.01, 0.1)  # takes 0.7 s
GRASP = hand_request(0.03, 0.005, 0.005, 0.5, 20.0)


@dataclass
class Bench:
    """A stand-in with both clients connected, and the fault to be shown."""

    fci: HostileStandIn
    arm: RawArm
    hand: RawHand
    name: str

    def begin(self) -> dict:
        return self.fci.do("fault", name=self.name)

    def state(self) -> p.RobotState:
        """Begin the fault; return a state of the arm that was sent during it."""
        begun = self.begin()["fault"]["at_ms"]
        state = self.arm.state()
        while state.message_id <= begun:
            state = self.arm.state()
        return state

    def truth_m(self) -> np.ndarray:
        return np.array(self.fci.do("look")["arm"]["position_m"])

    def start(self) -> None:
        self.arm.state()
        self.arm.start()

    def pull(self, ticks: int) -> p.RobotState:
        """Pull the hand down."""
        goal = self.truth_m() - [0, 0, 0.03]
        return self.arm.loop(pull_to(goal), ticks)


@pytest.fixture(scope="module")
def running() -> Iterator[list[HostileStandIn]]:
    """The stand-ins of this file; the last one is used while it lives."""
    standins: list[HostileStandIn] = []
    yield standins
    for standin in standins:
        standin.close()


@pytest.fixture
def fci(running: list[HostileStandIn], address: str) -> HostileStandIn:
    if not running or running[-1].process.poll() is not None:
        running.append(HostileStandIn(address, "--hand-hz", "50"))
    running[-1].do("object", width_m=0.0)
    return running[-1]


@pytest.fixture
def clients(fci: HostileStandIn) -> Iterator[tuple[RawArm, RawHand]]:
    with RawArm(fci.address) as arm, RawHand(fci.address) as hand:
        yield arm, hand


def datagrams_for(client: RawArm | RawHand, seconds: float) -> list[bytes]:
    """Return what arrives on the UDP socket."""
    end, got = time.monotonic() + seconds, []
    client.udp.settimeout(seconds)
    while time.monotonic() < end:
        try:
            got.append(client.datagram())
        except TimeoutError:
            break
    return got


def fresh(client: RawArm | RawHand, seconds: float = SILENCE_s) -> list[bytes]:
    """Return what arrives from now on, without what was queued."""
    client.udp.setblocking(False)
    try:
        while True:
            client.udp.recv(65536)
    except BlockingIOError:
        return datagrams_for(client, seconds)


# --- the arm's states ------------------------------------------------------------------------------------------------


def not_finite(bench: Bench) -> None:
    state = bench.state()
    test = np.isnan if bench.name == "nan_state" else np.isinf
    assert all(test(state[name]).all() for name in ("O_T_EE", "q", "dq"))
    assert np.isfinite(state["O_F_ext_hat_K"]).all()


def nan_force(bench: Bench) -> None:
    state = bench.state()
    assert np.isnan(state["O_F_ext_hat_K"]).all() and np.isnan(state["tau_ext_hat_filtered"]).all()
    assert np.isfinite(state["O_T_EE"]).all() and np.isfinite(state["q"]).all()


def pose_jump(bench: Bench) -> None:
    before = bench.arm.newest()
    states = [bench.state(), bench.arm.state()]
    for state in states:
        jump_m = np.linalg.norm(state["O_T_EE"][12:15] - before["O_T_EE"][12:15])
        assert jump_m == pytest.approx(0.1, abs=0.02)
        np.testing.assert_allclose(state["q"] - before["q"], [0.3, 0, 0, 0, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(bench.truth_m(), before["O_T_EE"][12:15], atol=1e-6)


def velocity_beyond_physics(bench: Bench) -> None:
    assert (np.abs(bench.state()["dq"]) > 5 * DQ_MAX_rad_s).all()
    assert bench.fci.do("look")["arm"]["speed_rad_s"] == 0.0


def frozen_state(bench: Bench) -> None:
    bench.start()
    bench.pull(20)
    begun, first = bench.truth_m(), bench.state()
    last = bench.pull(50)
    assert last.message_id > first.message_id + 20
    for name in ("O_T_EE", "q", "dq"):
        np.testing.assert_array_equal(last[name], first[name])
    assert np.linalg.norm(bench.truth_m() - begun) > 1e-3, "the arm itself moves"


def stopped_clock(bench: Bench) -> None:
    bench.begin()
    got = fresh(bench.arm)
    assert len(got) > 10 and len(set(got)) == 1
    assert decode_state(got[0]).message_id <= bench.fci.do("look")["fault"]["at_ms"]


def state_flood_old(bench: Bench) -> None:
    fresh(bench.arm, 0.05)
    begun = bench.begin()["fault"]["at_ms"]
    ids = [decode_state(datagram).message_id for datagram in fresh(bench.arm)]
    assert len(ids) > 10 and max(ids) <= begun and ids != sorted(ids)


def silent_arm(bench: Bench) -> None:
    begun = bench.begin()["arm"]["milliseconds"]
    assert not fresh(bench.arm)
    assert bench.fci.do("look")["arm"]["milliseconds"] > begun
    assert bench.arm.ask(p.ArmCommand.STOP_MOVE) == b"\0", "TCP lives"


def garbage_state(bench: Bench) -> None:
    begun = bench.begin()["fault"]["at_ms"]
    got = fresh(bench.arm)
    assert len(got) > 10 and len(set(got)) == len(got)
    assert {len(datagram) for datagram in got} == {p.STATE_BYTES}
    assert all(decode_state(datagram).message_id > begun + 10**6 for datagram in got[:10])


def wrong_length_state(bench: Bench) -> None:
    bench.begin()
    sizes = {len(datagram) for datagram in fresh(bench.arm)}
    assert len(sizes) > 2 and p.STATE_BYTES not in sizes


# --- the arm's connection --------------------------------------------------------------------------------------------


def lost_commands(bench: Bench) -> None:
    bench.start()
    bench.pull(10)
    bench.begin()
    bench.pull(50)
    assert bench.arm.receive().payload == bytes([p.MoveStatus.REFLEX_ABORTED])
    look = bench.fci.do("look")
    assert look["arm"]["errors"] == [p.ErrorBit.COMMUNICATION_CONSTRAINTS_VIOLATION]
    assert bench.arm.ask(p.ArmCommand.AUTOMATIC_ERROR_RECOVERY) == b"\0"


def garbage_reply(bench: Bench) -> None:
    client = bench.arm if bench.name == "arm_garbage_reply" else bench.hand
    bench.begin()
    assert client.tcp.recv(65536), "unasked"
    request = p.ArmCommand.STOP_MOVE if client is bench.arm else p.HandCommand.STOP
    asked = client.send(request)
    answer = client.tcp.recv(65536)
    proper = [client.header.encode(p.Message(request, asked, status)) for status in (b"\0", b"\0\0")]
    assert answer and answer not in proper


def arm_dropped(bench: Bench) -> None:
    bench.start()
    bench.pull(50)
    bench.begin()
    with pytest.raises(ConnectionError):
        bench.arm.receive()
    assert not bench.fci.do("look")["arm"]["moving"]


def server_death(bench: Bench) -> None:
    bench.fci.die()
    assert bench.fci.process.returncode == DIED
    with pytest.raises(ConnectionError):
        bench.arm.receive()


# --- what stops a real arm -------------------------------------------------------------------------------------------


def user_stop(bench: Bench) -> None:
    bench.start()
    bench.begin()
    assert bench.arm.receive().payload == bytes([p.MoveStatus.EMERGENCY_ABORTED])
    assert bench.state().mode == p.RobotMode.USER_STOPPED


REASONS = {
    "reflex": p.ErrorBit.CARTESIAN_REFLEX,
    "joint_reflex": p.ErrorBit.JOINT_REFLEX,
    "torque_discontinuity": p.ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY,
    "joint_velocity": p.ErrorBit.JOINT_VELOCITY_VIOLATION,
    "cartesian_velocity": p.ErrorBit.CARTESIAN_VELOCITY_VIOLATION,
    "joint_limit": p.ErrorBit.JOINT_POSITION_LIMITS_VIOLATION,
    "power_limit": p.ErrorBit.POWER_LIMIT_VIOLATION,
}


def reflex(bench: Bench) -> None:
    bench.start()
    state = bench.state()
    assert bench.arm.receive().payload == bytes([p.MoveStatus.REFLEX_ABORTED])
    assert (state.mode, state.errors) == (p.RobotMode.REFLEX, {REASONS[bench.name]})
    assert bench.arm.ask(p.ArmCommand.AUTOMATIC_ERROR_RECOVERY) == b"\0"


# --- the hand --------------------------------------------------------------------------------------------------------


def hung_hand(bench: Bench) -> None:
    bench.begin()
    asked = bench.hand.send(p.HandCommand.MOVE, SLOW_MOVE)
    widths = [decode_hand_state(datagram).width_m for datagram in fresh(bench.hand)]
    assert len(set(widths[-3:])) == 1 and 0.01 < widths[-1] < 0.08
    bench.hand.send(p.HandCommand.STOP)
    bench.hand.tcp.settimeout(SILENCE_s)
    with pytest.raises(TimeoutError):
        bench.hand.receive()
    bench.hand.tcp.settimeout(10.0)
    bench.fci.do("fault", name=NONE)
    answer = bench.hand.receive()
    assert (answer.command_id, answer.payload[0]) == (asked, p.HandStatus.SUCCESS), "it goes on"


def hand_silent(bench: Bench) -> None:
    bench.begin()
    assert not fresh(bench.hand)
    assert bench.hand.status_of(p.HandCommand.STOP) == p.HandStatus.SUCCESS, "TCP lives"


def hand_dropped(bench: Bench) -> None:
    bench.begin()
    with pytest.raises(ConnectionError):
        bench.hand.receive()


def hand_dropped_midway(bench: Bench) -> None:
    bench.begin()
    assert bench.hand.status_of(p.HandCommand.STOP) == p.HandStatus.SUCCESS, "no command is under way"
    bench.hand.send(p.HandCommand.MOVE, SLOW_MOVE)
    with pytest.raises(ConnectionError):
        bench.hand.receive()
    assert 0.01 < bench.fci.do("look")["hand"]["width_m"] < 0.08


def hand_garbage_state(bench: Bench) -> None:
    bench.begin()
    got = fresh(bench.hand)
    assert {len(datagram) for datagram in got} == {p.HAND_STATE_BYTES} and len(set(got)) > 1
    widths = np.array([decode_hand_state(datagram).width_m for datagram in got])
    assert not np.any((widths > 1e-6) & (widths < 0.08))


def nan_width(bench: Bench) -> None:
    bench.begin()
    assert all(np.isnan(decode_hand_state(datagram).width_m) for datagram in fresh(bench.hand))
    assert bench.fci.do("look")["hand"]["width_m"] == 0.08


def slip_out(bench: Bench) -> None:
    bench.fci.do("object", width_m=0.031)
    assert bench.hand.status_of(p.HandCommand.GRASP, GRASP) == p.HandStatus.SUCCESS
    bench.begin()
    wait_until(lambda: bench.fci.do("look")["hand"]["width_m"] == 0.0, 30, "closed fingers")
    seen = decode_hand_state(fresh(bench.hand)[-1])
    assert not seen.is_grasped and seen.width_m == 0.0


# every other fault is shown by the function of its name
SHOWS: dict[str, Callable[[Bench], None]] = {
    **dict.fromkeys(("nan_state", "inf_state"), not_finite),
    **dict.fromkeys(("arm_garbage_reply", "hand_garbage_reply"), garbage_reply),
    **dict.fromkeys(REASONS, reflex),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_shows_on_the_wire_and_can_be_taken_back(
    name: str, fci: HostileStandIn, clients: tuple[RawArm, RawHand]
) -> None:
    """A fault that nothing here shows fails: it needs a test."""
    begun_s = time.monotonic()
    show = SHOWS[name] if name in SHOWS else globals()[name]
    show(Bench(fci, *clients, name))
    if fci.process.poll() is not None:
        return
    shown = fci.do("fault", name=NONE)["fault"]
    assert (shown["name"], shown["last"]) == (NONE, name) and begun_s < shown["at_s"] < time.monotonic()
    for client in clients:
        client.close()
    whole_again(fci)


def whole_again(fci: HostileStandIn) -> None:
    """Open the fingers, connect anew and see true states."""
    with RawArm(fci.address) as arm, RawHand(fci.address) as hand:
        state, truth = arm.state(), fci.do("look")["arm"]
        np.testing.assert_allclose(state["O_T_EE"][12:15], truth["position_m"], atol=2e-3)
        assert np.isfinite(state.floats).all() and state.mode == p.RobotMode.IDLE
        assert arm.state().message_id == state.message_id + 1
        assert hand.state().width_m == pytest.approx(fci.do("look")["hand"]["width_m"], abs=5e-3)
        assert hand.status_of(p.HandCommand.MOVE, hand_request(0.08, 0.5)) == p.HandStatus.SUCCESS
