"""Every dataset and observation key, spelled once. LeRobot types a feature by its key's prefix.

``observation.images.*`` passes record, train, eval and rollout untouched; a key without the
``observation.`` prefix never reaches a policy, which is what truth and provenance columns need.
"""

from uniforce_vtla.contracts import Finger

STATE = "observation.state"
ACTION = "action"
TASK = "task"

CAMERAS = ("front", "wrist")
# m, m, m, rad, m in the robot base frame
AXES = ("x.pos", "y.pos", "z.pos", "yaw.pos", "width.pos")
SLOTS = ("touch0", "touch1")

VIEW_MARKER = "uniforce_view.json"  # written last: a folder with it is a whole training view

OUTCOME_NAMES = ("aborted", "failed_grasp", "residual", "success")  # in order of precedence


def camera_key(camera: str) -> str:
    """Key of a camera's video, e.g. ``observation.images.front``."""
    return f"observation.images.{camera}"


def tactile_name(finger: Finger, reference: bool = False) -> str:
    """Name of a finger's marker stream inside an environment's ``pixels`` dict."""
    if reference:
        return f"tactile_{finger}_ref"
    return f"tactile_{finger}"


def tactile_key(finger: Finger, reference: bool = False) -> str:
    """Key of a finger's marker image, or of the episode's reference beside it."""
    return camera_key(tactile_name(finger, reference))


def latent_key(slot: str) -> str:
    """Key of a slot's cached pooled latents, (K·latent,) float32."""
    return f"observation.latent.{slot}"


def force_axes(finger: Finger) -> tuple[str, str, str]:
    """Names of a finger's newtons where they stand in the state: x right, y down, z compression."""
    return f"{finger}_fx", f"{finger}_fy", f"{finger}_fz"


def wrench_key(slot: str) -> str:
    """Key of a slot's true pad wrench (control), (4,) float32: fx, fy, fz N, torsion Nmm."""
    return f"observation.wrench.{slot}"


def truth_wrench_key(finger: Finger) -> str:
    """Per-frame truth column, canonical frame, (4,) float32: fx, fy, fz in N, torsion in Nmm."""
    return f"truth.wrench.{finger}"


def sensor_key(finger: Finger) -> str:
    """Per-frame column holding the registry index of the sensor on a finger."""
    return f"provenance.sensor.{finger}"


def time_key(source: str) -> str:
    """Per-frame column: capture time of a finger's or camera's frame, float64 s of the episode."""
    return f"provenance.time.{source}"


def age_key(source: str) -> str:
    """Per-frame column: how old that frame was when the observation was taken, float32 seconds."""
    return f"provenance.age.{source}"


def index_key(source: str) -> str:
    """Per-frame column: number of that frame since its sensor connected, int64; may have gaps."""
    return f"provenance.index.{source}"


def measured_key(name: str) -> str:
    """Per-frame column of a robot's other measurements, e.g. ``measured.wrench``."""
    return f"measured.{name}"


def counts_key(finger: Finger) -> str:
    """Per-frame column: newest raw scan of a finger's taxels, upright, (48,) int32."""
    return f"raw.counts.{finger}"


def window_key(finger: Finger) -> str:
    """Per-frame column: newest scans of a finger's taxels, oldest first, (size · 48,) int32."""
    return f"raw.window.{finger}"


def window_time_key(finger: Finger) -> str:
    """Per-frame column: when those scans were taken, (size,) float64 s on the episode's clock."""
    return f"raw.window_time.{finger}"


# Per-frame columns of recorded equilibrium pairs: measured or estimated, never truth.
PAIR_ERROR = "pair.error"  # estimated ‖F_left − F_right‖ over their mean
PAIR_VELOCITY = "pair.velocity"  # (3,) m/s of the hand in its own frame, x = closing axis
PAIR_ACCELERATION = "pair.acceleration"  # (3,) m/s² of the hand in its own frame
PAIR_GRIP = "pair.grip"  # N, the gripper's own estimate
PAIR_INDENTER = "pair.indenter"  # index into the recording's indenters
# counts reference captures: pairs of one number share their references
PAIR_SESSION = "pair.session"


def pair_force_key(finger: Finger) -> str:
    """Per-frame column: estimated force on a pad, canonical frame, (3,) float32 N."""
    return f"pair.force.{finger}"


TACTILE_NAMES = ("tactile_left", "tactile_left_ref", "tactile_right", "tactile_right_ref")
TACTILE_KEYS = tuple(camera_key(name) for name in TACTILE_NAMES)
SUCCESS = "provenance.success"  # 1.0 if the episode ended in clean success
OUTCOME = "provenance.outcome"  # index into OUTCOME_NAMES
SEED = "provenance.seed"  # the integer that rebuilds the scene; on a robot, counts the attempts
CAUSE = "provenance.cause"  # index into ABORT_CAUSES
STAMPS = "provenance.stamps"  # (3,) float64 s on the episode's clock, see STAMP_NAMES
STAMP_NAMES = ("tick_begun", "observed", "acted")
# (5,) what the teleoperator asked for; ``action`` is what the guards let through
REQUESTED = "provenance.requested"

# Why an episode was aborted. Append only: datasets store the index.
ABORT_CAUSES = (
    "none",
    "lost_camera",
    "stale_camera",
    "frozen_camera",
    "bad_camera",
    "lost_touch",
    "stale_touch",
    "frozen_touch",
    "bad_touch",
    "robot_connection",
    "robot_version",
    "robot_reflex",
    "robot_user_stop",
    "robot_guiding",
    "robot_action",
    "robot_stale",
    "robot_ended",
    "robot_backend",
    "robot_other",
    "teleop",
    "disk_full",
    "storage",
    "dropped_frame",
    "interrupt",
    "other",
    "robot_bad_state",
    "robot_jump",
    "robot_speed",
    "robot_force",
    "robot_frozen",
    "robot_guard",
    "robot_sensor",
    "robot_communication",
    "robot_discontinuity",
    "robot_limit",
    "robot_hand_connection",
    "robot_hand_stale",
    "robot_hand_deadline",
    "robot_hand_state",
    "robot_grasp_lost",
    "late",
    "robot_tilt",
    "robot_frame",
)
