"""How the stand-in's arm moves: joints with inertia under torques, and the wrench at the hand.

Gravity and Coriolis forces are compensated, as by the real controller. No dynamics model, but
targets are reached and a press on the wall gives stiffness × distance.
"""

from dataclasses import dataclass, field

import numpy as np

import uniforce_robots.fr3 as fr3
from uniforce_robots.standins.fci.protocol import STATE_FLOAT_COUNT, STATE_SLICES, ErrorBit

TICK_s = 0.001
# at each joint, about 3 kg at the hand
INERTIA_kgm2 = np.array([1.0, 1.0, 0.8, 0.8, 0.25, 0.25, 0.12])
FRICTION_Nms = np.array([0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 0.1])
# of the joint speed left each millisecond when something stops the arm: still after 50 ms
BRAKE_SHARE = 0.9
STILL_rad_s = 1e-9
GUIDING_DAMPING_Nms = 5.0  # a hand that pushes moves the arm, and it stops when the push does
# Limits of the FR3 in Franka's interface specification and libfranka's rate_limiting.h. How much a
# real controller tolerates beyond them is not published, so a small share is allowed.
TOLERANCE = 1.01  # states are float32, and a client's rounding is no fault
TORQUE_STEP_Nm = 1.0  # a millisecond: 1000 Nm/s
SPEED_MAX_m_s = 3.0  # of the hand (FR3 specification)


@dataclass(frozen=True)
class Wall:
    """A springy table: pushes up on a hand that is below it."""

    height_m: float
    stiffness_N_m: float = 5000.0
    damping_Ns_m: float = 100.0


@dataclass
class Arm:
    """Seven joints and the hand's frame; a motion's call is one millisecond of the robot's time."""

    q_rad: np.ndarray = field(default_factory=fr3.HOME_q_rad.copy)
    dq_rad_s: np.ndarray = field(default_factory=lambda: np.zeros(fr3.JOINTS))
    tau_Nm: np.ndarray = field(default_factory=lambda: np.zeros(fr3.JOINTS))
    # from outside; base frame, at the hand
    wrench_N: np.ndarray = field(default_factory=lambda: np.zeros(6))
    wall: Wall | None = None
    upper_torque_Nm: np.ndarray = field(default_factory=lambda: np.full(fr3.JOINTS, 20.0))
    upper_force_N: np.ndarray = field(default_factory=lambda: np.full(6, 30.0))

    def __post_init__(self) -> None:
        self.refresh()

    def refresh(self) -> None:
        """Recompute what follows from the joint angles and from what was set from outside."""
        self._floats: np.ndarray | None = None
        here = fr3.posture(self.q_rad)
        self.ee_to_base = here.flange_to_base @ fr3.HAND_TO_FLANGE
        self.jacobian = here.jacobian(self.ee_to_base[:3, 3])
        self.twist = self.jacobian @ self.dq_rad_s  # of the hand, m/s and rad/s
        self.contact_N = self._contact()
        self.tau_ext_Nm = self.jacobian.T @ self.contact_N

    def _contact(self) -> np.ndarray:
        """Return (6,) wrench on the hand: what was set, and the wall."""
        wrench = self.wrench_N.copy()
        if self.wall is not None:
            depth = self.wall.height_m - self.ee_to_base[2, 3]
            if depth > 0:
                speed = float(self.twist[2])
                wrench[2] += max(
                    self.wall.stiffness_N_m * depth - self.wall.damping_Ns_m * speed, 0.0
                )
        return wrench

    def drive(self, tau_Nm: np.ndarray) -> None:
        """Follow torques (7,) for a millisecond."""
        self.tau_Nm = np.clip(tau_Nm, -fr3.TAU_MAX_Nm, fr3.TAU_MAX_Nm)
        self._accelerate(self.tau_Nm + self.tau_ext_Nm - FRICTION_Nms * self.dq_rad_s)

    def hold(self) -> None:
        """Brake for a millisecond: nothing commands the arm."""
        if not self.tau_Nm.any() and np.abs(self.dq_rad_s).max() < STILL_rad_s:
            return  # spares an idle arm, which is most of a test's time, its kinematics
        self.tau_Nm = np.zeros(fr3.JOINTS)
        self.dq_rad_s = self.dq_rad_s * BRAKE_SHARE
        self._integrate()

    def guide(self) -> None:
        """Be pushed for a millisecond."""
        self.tau_Nm = np.zeros(fr3.JOINTS)
        self._accelerate(self.tau_ext_Nm - GUIDING_DAMPING_Nms * self.dq_rad_s)

    def _accelerate(self, torque_Nm: np.ndarray) -> None:
        self.dq_rad_s = self.dq_rad_s + TICK_s * torque_Nm / INERTIA_kgm2
        self._integrate()

    def _integrate(self) -> None:
        self.q_rad = self.q_rad + TICK_s * self.dq_rad_s
        self.refresh()

    def violations(self) -> frozenset[int]:
        """Return the error bits that would stop a motion now."""
        found = set()
        if np.any(np.abs(self.contact_N) > self.upper_force_N):
            found.add(ErrorBit.CARTESIAN_REFLEX)
        if np.any(np.abs(self.tau_ext_Nm) > self.upper_torque_Nm):
            found.add(ErrorBit.JOINT_REFLEX)
        if np.any(np.abs(self.dq_rad_s) > fr3.DQ_MAX_rad_s * 1.001):
            found.add(ErrorBit.JOINT_VELOCITY_VIOLATION)
        if self.twist[:3] @ self.twist[:3] > SPEED_MAX_m_s**2:
            found.add(ErrorBit.CARTESIAN_VELOCITY_VIOLATION)
        if np.any((self.q_rad < fr3.Q_MIN_rad) | (self.q_rad > fr3.Q_MAX_rad)):
            found.add(ErrorBit.JOINT_POSITION_LIMITS_VIOLATION)
        return frozenset(found)

    def state_floats(self) -> np.ndarray:
        """Return (320,) float32 of a state, cut by ``STATE_SLICES``."""
        if self._floats is None:
            self._floats = np.zeros(STATE_FLOAT_COUNT, np.float32)
            for name, value in self._state_values().items():
                self._floats[STATE_SLICES[name]] = value
        return self._floats

    def _state_values(self) -> dict[str, np.ndarray]:
        pose = self.ee_to_base.T.ravel()
        motor = {"q": self.q_rad, "dq": self.dq_rad_s, "tau_J": self.tau_Nm}
        return {
            **dict.fromkeys(("O_T_EE", "O_T_EE_d", "O_T_EE_c"), pose),
            **dict.fromkeys(("F_T_EE", "F_T_NE"), fr3.HAND_TO_FLANGE.T.ravel()),
            **dict.fromkeys(("EE_T_K", "NE_T_EE"), np.eye(4).ravel()),
            **motor,
            **{f"{name}_d": value for name, value in motor.items()},
            "theta": self.q_rad,
            "dtheta": self.dq_rad_s,
            "tau_ext_hat_filtered": self.tau_ext_Nm,
            "O_F_ext_hat_K": self.contact_N,
            "K_F_ext_hat_K": (self.contact_N.reshape(2, 3) @ self.ee_to_base[:3, :3]).ravel(),
            **dict.fromkeys(("O_dP_EE_c", "O_dP_EE_d"), self.twist),
            "O_ddP_O": np.array([0.0, 0.0, -9.81]),  # a client computes gravity from this
        }

    def describe(self) -> dict[str, object]:
        """Return where the arm really is and what really drives it, whatever its states say."""
        return {
            "q_rad": self.q_rad.tolist(),
            "position_m": self.ee_to_base[:3, 3].tolist(),
            "rotation": self.ee_to_base[:3, :3].tolist(),
            "speed_rad_s": float(np.abs(self.dq_rad_s).max()),
            "contact_N": self.contact_N.tolist(),
            "tau_Nm": self.tau_Nm.tolist(),
        }


def broken_rules(tau_Nm: np.ndarray, before_Nm: np.ndarray | float = 0.0) -> frozenset[int]:
    """Return the error bits of torques (7,), after others, that the real arm would not follow."""
    found = set()
    if (np.abs(tau_Nm - before_Nm) > TOLERANCE * TORQUE_STEP_Nm).any():
        found.add(ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY)
    if (np.abs(tau_Nm) > TOLERANCE * fr3.TAU_MAX_Nm).any():
        found.add(ErrorBit.TAU_J_RANGE_VIOLATION)
    return frozenset(found)
