"""Every dataset and observation key, spelled once. LeRobot types a feature by its key's prefix.

``observation.images.*`` passes record, train, eval and rollout untouched; a key without the
``observation.`` prefix never reaches a policy, which is what truth and provenance columns need.
"""

from uniforce_vtla.contracts import FINGERS, Finger

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
    """Key of a scene camera's video, e.g. ``observation.images.front``."""
    return f"observation.images.{camera}"


def tactile_name(finger: Finger, reference: bool = False) -> str:
    """Name of a finger's marker stream inside an environment's ``pixels`` dict."""
    return f"tactile_{finger}_ref" if reference else f"tactile_{finger}"


def tactile_key(finger: Finger, reference: bool = False) -> str:
    """Key of a finger's marker image, or of the episode's reference beside it."""
    return f"observation.images.{tactile_name(finger, reference)}"


def latent_key(slot: str) -> str:
    """Key of a slot's cached pooled latents, (K·latent,) float32."""
    return f"observation.latent.{slot}"


def wrench_key(slot: str) -> str:
    """Key of a slot's true pad wrench (ceiling control only), (4,) float32: fx, fy, fz N, torsion Nmm."""
    return f"observation.wrench.{slot}"


def descriptor_key(slot: str) -> str:
    """Key of a slot's hand descriptor (control), (6,) float32."""
    return f"observation.descriptor.{slot}"


def marker_pair_key(slot: str) -> str:
    """Key of a slot's small reference and current image (control), (2, S, S) uint8."""
    return f"observation.marker_pair.{slot}"


def truth_wrench_key(finger: Finger) -> str:
    """Per-frame truth column, canonical frame, (4,) float32: fx, fy, fz in N, torsion in Nmm."""
    return f"truth.wrench.{finger}"


def sensor_key(finger: Finger) -> str:
    """Per-frame column holding the registry index of the sensor on a finger."""
    return f"provenance.sensor.{finger}"


def time_key(source: str) -> str:
    """Per-frame column: when a finger's or camera's frame was captured, float64 s on the episode's clock."""
    return f"provenance.time.{source}"


def age_key(source: str) -> str:
    """Per-frame column: how old that frame was when the observation was taken, float32 seconds."""
    return f"provenance.age.{source}"


def index_key(source: str) -> str:
    """Per-frame column: number of that frame since its sensor connected, int64; gaps tell what was left out."""
    return f"provenance.index.{source}"


def measured_key(name: str) -> str:
    """Per-frame column a robot measures besides the state, e.g. ``measured.wrench``; no policy reads it."""
    return f"measured.{name}"


def counts_key(finger: Finger) -> str:
    """Per-frame column: newest raw scan of a finger's taxels, upright, (48,) int32."""
    return f"raw.counts.{finger}"


def window_key(finger: Finger) -> str:
    """Per-frame column: the newest scans of a finger's taxels, oldest first, upright, (size · 48,) int32."""
    return f"raw.window.{finger}"


def window_time_key(finger: Finger) -> str:
    """Per-frame column: when those scans were taken, (size,) float64 s on the episode's clock."""
    return f"raw.window_time.{finger}"


# Per-frame columns of recorded equilibrium pairs; everything in them is measured or estimated, nothing is truth.
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


TACTILE_NAMES = tuple(tactile_name(f, r) for f in FINGERS for r in (False, True))
TACTILE_KEYS = tuple(tactile_key(f, r) for f in FINGERS for r in (False, True))
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
    *(
        f"{how}_{what}"
        for what in ("camera", "touch")
        for how in ("lost", "stale", "frozen", "bad")
    ),
    *(
        f"robot_{fault}"
        for fault in ("connection", "version", "reflex", "user_stop", "guiding", "action", "stale")
    ),
    *(
        "robot_ended",
        "robot_backend",
        "robot_other",
        "teleop",
        "disk_full",
        "storage",
        "dropped_frame",
    ),
    *("interrupt", "other"),
    *(
        f"robot_{fault}"
        for fault in ("bad_state", "jump", "speed", "force", "frozen", "guard", "sensor")
    ),
    *(f"robot_{fault}" for fault in ("communication", "discontinuity", "limit")),
    *(f"robot_hand_{fault}" for fault in ("connection", "stale", "deadline", "state")),
    *("robot_grasp_lost", "late", "robot_tilt", "robot_frame"),
)
