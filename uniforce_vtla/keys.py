"""Every dataset and observation key, spelled once. LeRobot types a feature by its key's prefix.

``observation.images.*`` passes record, train, eval and rollout untouched; a key without the
``observation.`` prefix never reaches a policy, which is what truth and provenance columns need.
"""

from uniforce_vtla.contracts import FINGERS, Finger

STATE = "observation.state"
ACTION = "action"

CAMERAS = ("front", "wrist")
AXES = ("x.pos", "y.pos", "z.pos", "yaw.pos", "width.pos")  # m, m, m, rad, m in the robot base frame
SLOTS = ("touch0", "touch1")

VIEW_MARKER = "uniforce_view.json"  # written last: a folder with it is a whole training view

OUTCOME_NAMES = ("aborted", "failed_grasp", "residual", "success")  # in order of precedence


def tactile_name(finger: Finger, reference: bool = False) -> str:
    """Name of a finger's marker stream inside an environment's ``pixels`` dict."""
    return f"tactile_{finger}_ref" if reference else f"tactile_{finger}"


def tactile_key(finger: Finger, reference: bool = False) -> str:
    """Key of a finger's marker image, or of the episode's reference beside it."""
    return f"observation.images.{tactile_name(finger, reference)}"


# What has a key of its own for each camera, slot, finger, source or name, with which these are called.
camera_key = "observation.images.{}".format  # a scene camera's video
latent_key = "observation.latent.{}".format  # a slot's cached pooled latents, (K·latent,) float32
# a slot's true pad wrench (ceiling control only), (4,) float32: fx, fy, fz N, torsion Nmm
wrench_key = "observation.wrench.{}".format
descriptor_key = "observation.descriptor.{}".format  # a slot's hand descriptor (control), (6,) float32
# a slot's small reference and current image (control), (2, S, S) uint8
marker_pair_key = "observation.marker_pair.{}".format

# Likewise, per-frame columns.
# a finger's true pad wrench, canonical frame, (4,) float32: fx, fy, fz in N, torsion in Nmm
truth_wrench_key = "truth.wrench.{}".format
sensor_key = "provenance.sensor.{}".format  # registry index of the sensor on a finger
# when a finger's or camera's frame was captured, float64 s on the episode's clock
time_key = "provenance.time.{}".format
age_key = "provenance.age.{}".format  # how old that frame was when the observation was taken, float32 seconds
# number of that frame since its sensor connected, int64; gaps tell what was left out
index_key = "provenance.index.{}".format
# what a robot measures besides the state, e.g. ``measured.wrench``; no policy reads it
measured_key = "measured.{}".format
counts_key = "raw.counts.{}".format  # newest raw scan of a finger's taxels, upright, (48,) int32
# the newest scans of a finger's taxels, oldest first, upright, (size · 48,) int32
window_key = "raw.window.{}".format
window_time_key = "raw.window_time.{}".format  # when those were taken, (size,) float64 s on the episode's clock

# Columns of recorded equilibrium pairs; everything in them is measured or estimated, nothing is truth.
PAIR_ERROR = "pair.error"  # estimated ‖F_left − F_right‖ over their mean
PAIR_VELOCITY = "pair.velocity"  # (3,) m/s of the hand in its own frame, x = closing axis
PAIR_ACCELERATION = "pair.acceleration"  # (3,) m/s² likewise
PAIR_GRIP = "pair.grip"  # N, the gripper's own estimate
PAIR_PLACE = "pair.place"  # (2,) estimated place of the contact, x right and y down, −1 … 1 over the image
PAIR_INDENTER = "pair.indenter"  # index into the recording's indenters
PAIR_SESSION = "pair.session"  # counts reference captures: pairs of one number share their references
pair_force_key = "pair.force.{}".format  # estimated force on a pad, canonical frame, (3,) float32 N

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
    *(f"{how}_{what}" for what in ("camera", "touch") for how in ("lost", "stale", "frozen", "bad")),
    *(f"robot_{fault}" for fault in ("connection", "version", "reflex", "user_stop", "guiding", "action", "stale")),
    *("robot_ended", "robot_backend", "robot_other", "teleop", "disk_full", "storage", "dropped_frame"),
    *("interrupt", "other"),
    *(f"robot_{fault}" for fault in ("bad_state", "jump", "speed", "force", "frozen", "guard", "sensor")),
    *(f"robot_{fault}" for fault in ("communication", "discontinuity", "limit")),
    *(f"robot_hand_{fault}" for fault in ("connection", "stale", "deadline", "state")),
    *("robot_grasp_lost", "late"),
)
