"""Base of all our teleoperators: five absolute axes out, a start on the measured pose, one error.

An episode is ``start_from(measured)``, then per tick ``send_feedback(measured)`` and
``get_action()``.

An arm must not go on by itself because a device is plugged in again, or was pushed all the while.
Two rules for every device: a fault or a loss, also one that no tick saw, stays until the next
``start_from``; and that refuses a device that isn't at rest. So every motion was asked for after
the start.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from uniforce_robots.franka.arm import Gains
from uniforce_robots.franka.poses import by_axis, shortest_turn
from uniforce_robots.sensors.faults import ProtocolError, StaleSensorError
from uniforce_robots.teleop.integrator import TargetIntegrator
from uniforce_vtla.errors import SensorError, TeleoperatorError, expected
from uniforce_vtla.keys import AXES

# without a call, after which the robot may have come to rest: its watchdog waits 0.2 s
GAP_S = 0.15
# m, rad, m of width: how far a device with a pose of its own may be from the robot at the start
START = 0.05, 0.3, 0.03
# an older measured pose is not where the robot is; its own watchdog has the same
FEEDBACK_AGE_S = 0.2


def checked_axes(axes: Mapping[str, Any] | np.ndarray, what: str) -> np.ndarray:
    """Return (5,) float64 of a dict by ``keys.AXES`` or of five numbers.

    Raises TeleoperatorError: one is missing or isn't finite.
    """
    try:
        values: Any = axes
        if isinstance(axes, Mapping):
            values = [axes[axis] for axis in AXES]
        array = np.asarray(values, dtype=np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise TeleoperatorError(
            expected(what, AXES, repr(error), "Give all five."), "garbage"
        ) from error
    if array.shape != (len(AXES),) or not np.isfinite(array).all():
        raise TeleoperatorError(
            expected(what, f"{AXES}, finite", array.tolist(), "Check it."), "garbage"
        )
    return array


def gap_sizes(gap: np.ndarray) -> tuple[float, float, float]:
    """Return m, rad and m of width of a difference (5,) of poses."""
    return (
        float(np.linalg.norm(gap[:3])),
        abs(shortest_turn(0.0, float(gap[3]))),
        abs(float(gap[4])),
    )


def require_near(name: str, target: np.ndarray, measured: np.ndarray) -> None:
    """Refuse a target (5,) too far from the measured axes; raises TeleoperatorError (``far``)."""
    gaps = gap_sizes(target - measured)
    if np.greater(gaps, START).any():
        wanted = "within {:.3f} m, {:.2f} rad, {:.3f} m of width of the robot".format(*START)
        came = "{:.3f} m, {:.2f} rad, {:.3f} m away".format(*gaps)
        raise TeleoperatorError(
            expected(name, wanted, came, "Bring them together, then start."), "far"
        )


class UniforceTeleoperator(Teleoperator):
    """A LeRobot teleoperator whose actions are absolute targets of ``keys.AXES``, base frame."""

    # stiffness the robot needs meanwhile; None for the robot's own
    wants_gains: ClassVar[Gains | None] = None
    # what is read, with ``start``, ``stop``, ``is_running``, and ``reconnects`` if it can be lost
    device: Any = None
    is_calibrated = True  # there is nothing to calibrate
    action_features = feedback_features = dict.fromkeys(AXES, float)  # target and measured axes

    def __init__(self, config: TeleoperatorConfig) -> None:
        super().__init__(config)
        self.config: Any = config
        self.clock: Callable[[], float] = time.monotonic
        self.integrator = TargetIntegrator(getattr(config, "limits", None))
        self._measured: np.ndarray | None = None
        self._measured_s = self._last_s = 0.0
        self._is_started = False
        # what is pushed now was pushed before a gap: it steers once it was let go
        self._must_rest = False
        self._lost = 0  # losses before the start
        self._fault: TeleoperatorError | None = None

    def calibrate(self) -> None:
        """Do nothing."""

    configure = calibrate

    def connect(self, calibrate: bool = True) -> None:
        """Open the device; TeleoperatorError: connected already, not there, no library for it."""
        if self.is_connected:
            raise TeleoperatorError(
                expected(self.name, "to be unconnected", "a second connect", "Disconnect first.")
            )
        with _translated():
            self._open()

    def disconnect(self) -> None:
        """Let go of the device and join its thread. Safe to call twice."""
        self._is_started = False
        self._close()

    def start_from(self, measured: Mapping[str, Any] | np.ndarray) -> None:
        """Begin an episode on the measured pose, (5,) or by ``keys.AXES``; forget an earlier fault.

        Raises TeleoperatorError: not connected, the device has a fault, it isn't at rest, or it
        stands too far from the robot (both ``far``).
        """
        self._check_connected()
        axes = checked_axes(measured, "measured pose")
        self._fault = None
        self._is_started = False
        self._lost = self._losses
        self._must_rest = False
        self.integrator.start_from(axes)
        self._measured = axes
        self._measured_s = self.clock()
        self._last_s = self._measured_s
        with _translated():
            self._begin(axes)
            is_at_rest = not self.is_deflected()
        if not is_at_rest:
            do = "Let go of it, then start."
            raise TeleoperatorError(
                expected(self.name, "a device at rest", "a deflected one", do), "far"
            )
        self._is_started = True

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Take the measured axes of this tick: for the leash, or as hand guiding's action."""
        self._measured = checked_axes(feedback, "feedback")
        self._measured_s = self.clock()

    def get_action(self) -> dict[str, float]:
        """Return the five absolute target axes.

        Raises TeleoperatorError: not connected, not started, or the device has a fault; see its
        ``fault``.
        """
        self._check_connected()
        if self._fault is not None:
            raise self._fault
        if not self._is_started:
            do = "Call start_from(measured) first; uniforce record does."
            wrong = expected(self.name, "a started episode", "none", do)
            raise TeleoperatorError(f"{wrong} LeRobot's own commands don't.", "not_started")
        now = self.clock()
        elapsed_s = now - self._last_s
        self._last_s = now
        try:
            self._refuse_lost()
            with _translated():
                if elapsed_s > GAP_S:
                    self._begin_again()
                axes = checked_axes(self._next(elapsed_s), f"{self.name}'s target")
        except TeleoperatorError as error:
            self._fault = error
            raise
        return by_axis(axes)

    @property
    def measured(self) -> np.ndarray | None:
        """(5,) the robot's newest measured pose, None when that is too long ago to rely on."""
        return self._measured if self.clock() - self._measured_s <= FEEDBACK_AGE_S else None

    @property
    def is_connected(self) -> bool:
        """Whether the device is read."""
        return self.device is not None and self.device.is_running

    def _open(self) -> None:
        self.device.start()

    def _close(self) -> None:
        self.device.stop()

    def rates(self) -> np.ndarray:
        """Return (5,) wanted speed of each axis as a share of its limit, −1 … 1; zeros at rest."""
        return np.zeros(len(AXES))

    def is_deflected(self) -> bool:
        """Return whether anything is pushed, also two buttons that cancel each other."""
        return bool(self.rates().any())

    def _next(self, elapsed_s: float) -> np.ndarray:
        """Return the next target (5,)."""
        rates = self.rates()
        self._must_rest = self._must_rest and self.is_deflected()
        return self.integrator.advance(rates * (not self._must_rest), elapsed_s, self.measured)

    def _begin_again(self) -> None:
        """Put the target on the measured pose after a gap: no old wish may move the robot on."""
        measured = self.measured
        if measured is not None:
            self.integrator.start_from(measured)
            self._begin(measured)
        self._must_rest = True

    def _begin(self, measured: np.ndarray) -> None:
        """Latch what an episode starts from; raise where it must not start."""

    @property
    def _losses(self) -> int:
        return getattr(self.device, "reconnects", 0)

    def _refuse_lost(self) -> None:
        if self._losses != self._lost:
            came = "one that was lost and came back"
            do = "Start again."
            raise TeleoperatorError(
                expected(self.name, "a device that stays", came, do), "connection"
            )

    def _check_connected(self) -> None:
        if not self.is_connected:
            do = "Call connect()."
            raise TeleoperatorError(
                expected(self.name, "a connected device", "none", do), "not_connected"
            )


@contextmanager
def _translated() -> Iterator[None]:
    """Turn the sensor reader's errors into teleoperator errors."""
    try:
        yield
    except StaleSensorError as error:
        raise TeleoperatorError(str(error), "stale") from error
    except ProtocolError as error:
        raise TeleoperatorError(str(error), "garbage") from error
    except SensorError as error:
        raise TeleoperatorError(str(error), "connection") from error
