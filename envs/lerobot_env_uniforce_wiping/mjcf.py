"""Scene → MJCF: a 7-DoF arm with published Franka kinematics, two soft fingers, an eraser, a board.

Primitives only, so nothing has to be downloaded. Collisions: pads with the eraser's block, its felt
with the board and the table; arm links touch nothing.
"""

from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.hidden import BOARD_HALF_m
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ, PadSettings
from lerobot_env_uniforce_wiping.scene_params import SceneParams
from uniforce_vtla.sensors import get_sensor

# Modified DH of the Franka arm (published): a m, d m, alpha rad of each frame in the one before.
DH = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
)
JOINT_LIMITS = (
    (-2.8973, 2.8973),
    (-1.7628, 1.7628),
    (-2.8973, 2.8973),
    (-3.0718, -0.0698),
    (-2.8973, 2.8973),
    (-0.0175, 3.7525),
    (-2.8973, 2.8973),
)
# plausible; gravity is compensated as on the real arm
LINK_MASS_kg = (4.0, 2.5, 3.0, 2.5, 2.0, 1.5, 0.6)
STICTION_SHARE = (1.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.3)  # small wrist gears stick less
LINK_CAPSULES = (  # from, to in the link's frame; radius m
    ((0, 0, -0.19), (0, 0, 0), 0.065),
    ((0, 0, 0), (0, -0.19, 0), 0.062),
    ((0, 0, -0.12), (0.0825, 0, 0), 0.058),
    ((0, 0, 0), (-0.0825, 0.12, 0), 0.056),
    ((0, 0, -0.25), (0, 0.03, 0), 0.052),
    ((0, 0, 0), (0.088, 0, 0), 0.048),
    ((0, 0, 0), (0, 0, 0.07), 0.045),
)
HAND_m = 0.107  # flange to hand
TCP_m = 0.1034  # hand to the point between the pads
FELT_m = 0.010  # felt thickness

STIFFNESS_N_m = (2000.0, 2000.0, 800.0)  # nominal Cartesian stiffness, x y z
ROTATION_Nm_rad = 60.0  # stiffness about each axis
DAMPING_RATIO = 0.8  # of the Cartesian impedance at nominal stiffness
EFFECTIVE_MASS_kg = 3.0  # of the tool at its tip, for the damping only
EFFECTIVE_INERTIA_kgm2 = 0.05  # of the tool about its tip, for the damping only
SHEAR_MASS_kg = 0.05  # armature that keeps the pad's shear mode stable at this time step
GRIPPER_N_m = 1200.0  # nominal stiffness of the gripper's servo, force per finger over width error
GRIPPER_FORCE_N = 70.0  # servo limit
# MuJoCo carries a box at its corners. At the radius of gyration of a 25 mm pad they rock like an
# even gel, and hold as much twist, 9.6 mm times friction; the pad's own corners would hold 18 mm
GYRATION_m = 0.0072
# tool frame in the base frame at yaw 0: x closes, z points down
TOOL_DOWN = np.diag([1.0, -1.0, -1.0])
READS = 4  # force samples averaged over a control step


@dataclass(frozen=True)
class SolverSettings:
    """How finely the physics is solved; see docs/results/physics.png (``benchmarks.physics``)."""

    # physics steps per force sample: 480 Hz; at 240 Hz the pads' shear springs break loose
    substeps: int = 4
    noslip_iterations: int = 8  # without them a held eraser creeps out of the hand

    @property
    def physics_hz(self) -> float:
        """Physics steps per second."""
        return CONTROL_HZ * READS * self.substeps

    @property
    def timestep_s(self) -> float:
        """Duration of a physics step."""
        return 1 / self.physics_hz


def _arm(scene: SceneParams) -> tuple[str, str]:
    opening = ""
    closing = ""
    for i, ((a, d, alpha), limit, mass, (start, end, radius)) in enumerate(
        zip(DH, JOINT_LIMITS, LINK_MASS_kg, LINK_CAPSULES, strict=True)
    ):
        position = (a, -d * np.sin(alpha), d * np.cos(alpha))
        opening += (
            f'<body name="link{i + 1}" pos="{_text(position)}" euler="{alpha} 0 0" gravcomp="1">'
            f'<joint name="joint{i + 1}" axis="0 0 1" range="{_text(limit)}" damping="1"'
            f' armature="0.1" frictionloss="{scene.stiction_Nm * STICTION_SHARE[i]}"/>'
            f'<geom name="link{i + 1}" type="capsule" fromto="{_text(start)} {_text(end)}"'
            f' size="{radius}" mass="{mass}" class="visual" rgba=".93 .93 .95 1"/>'
        )
        closing += "</body>"
    return opening, closing


def _text(values: object) -> str:
    return " ".join(f"{v:.9g}" for v in np.asarray(values, dtype=float).ravel())


def _finger(name: str, side: int, sensor: str, friction: float, pads: PadSettings) -> str:
    radius = get_sensor(sensor).dome_radius_mm
    contact = f'friction="{friction} 0.005 0.0001" condim="4" priority="2" solimp="0.5 0.5 0.001"'
    if radius is None:
        shape = f'type="box" size="0.0025 {GYRATION_m} {GYRATION_m}" pos="{side * 0.0025} 0 0"'
    else:
        shape = f'type="sphere" size="{radius / 1000}" pos="{side * radius / 1000} 0 0"'
    return (
        f'<body name="finger_{name}" pos="0 0 {TCP_m}" gravcomp="1">'
        f'<joint name="finger_{name}" type="slide" axis="{side} 0 0" range="0 0.04"'
        ' damping="10" armature="0.05"/>'
        f'<geom name="finger_{name}" type="box" size="0.006 0.011 0.026"'
        f' pos="{side * 0.014} 0 -0.022" mass="0.03" class="visual" rgba=".25 .25 .28 1"/>'
        # the same block is drawn for every sensor
        f'<geom name="skin_{name}" type="box" size="0.004 0.0125 0.0125"'
        f' pos="{side * 0.004} 0 0" mass="0.01" class="visual" rgba=".15 .55 .60 1"/>'
        f'<body name="pad_{name}" gravcomp="1">{_shear_springs(name, pads)}'
        f'<geom name="pad_{name}" {shape} {contact} mass="0.01" contype="1" conaffinity="0"'
        ' group="4"/></body></body>'
    )


def _shear_springs(name: str, pads: PadSettings) -> str:
    """Return two stiff slides across the pad; rigid friction leaves its load to the solver."""
    spring = (
        f'stiffness="{pads.shear_N_mm * 1000}" damping="{pads.shear_damping_Ns_m}"'
        f' armature="{SHEAR_MASS_kg}"/>'
    )
    return (
        f'<joint name="shear_{name}_y" type="slide" axis="0 1 0" {spring}'
        f'<joint name="shear_{name}_z" type="slide" axis="0 0 1" {spring}'
    )


def _tool(scene: SceneParams, sensors: tuple[str, str]) -> str:
    return (
        f'<body name="hand" pos="0 0 {HAND_m}" euler="0 0 {-np.pi / 4}" gravcomp="1">'
        '<geom name="hand" type="box" size="0.095 0.030 0.030" pos="0 0 0.033" mass="0.6"'
        ' class="visual" rgba=".85 .85 .88 1"/>'
        f'<site name="tcp" pos="0 0 {TCP_m}"/>'
        + _finger("left", -1, sensors[0], scene.pad_friction[0], scene.level.pads)
        + _finger("right", 1, sensors[1], scene.pad_friction[1], scene.level.pads)
        + "</body>"
    )


def _eraser(scene: SceneParams) -> str:
    layout = scene.level.layout
    half_x = scene.eraser_width_m / 2
    half_y = scene.eraser_length_m / 2
    half_z = (layout.eraser_height_m - FELT_m) / 2
    x = layout.tray_m[0] + scene.eraser_offset_m[0]
    y = layout.tray_m[1] + scene.eraser_offset_m[1]
    mass = scene.eraser_mass_kg
    return (
        f'<body name="eraser" pos="{x} {y} 0.0002" euler="0 0 {scene.eraser_turn_rad}">'
        '<freejoint name="eraser"/>'
        f'<geom name="block" type="box" size="{half_x} {half_y} {half_z}"'
        f' pos="0 0 {FELT_m + half_z}" mass="{0.8 * mass}" contype="0" conaffinity="1"'
        ' rgba=".15 .30 .75 1"/>'
        f'<geom name="felt" type="box" size="{half_x} {half_y} {FELT_m / 2}"'
        f' pos="0 0 {FELT_m / 2}" mass="{0.2 * mass}" contype="2" conaffinity="0" condim="3"'
        ' rgba=".35 .35 .35 1"/></body>'
    )


def _board(scene: SceneParams) -> str:
    x, y = np.add(scene.level.layout.board_center_m, scene.board_shift_m)
    tilt_x, tilt_y = scene.board_tilt_rad
    friction = f'friction="{scene.board_friction} 0.005 0.0001" priority="1"'
    # felt: some tenths of a mm at wiping force
    soft = 'solref="-20000 -250" solimp="0.5 0.5 0.001"'
    return (
        f'<body name="board" pos="{x} {y} {scene.board_height_m}"'
        f' euler="{tilt_x} {tilt_y} {scene.board_turn_rad}">'
        f'<geom name="board" type="box" size="{_text((*BOARD_HALF_m, 0.005))}" pos="0 0 -0.005"'
        f' contype="0" conaffinity="2" {friction} {soft} condim="3" rgba=".96 .97 .96 1"/></body>'
        '<geom name="table" type="box" size="0.40 0.50 0.01" pos="0.5 0 -0.01" contype="0"'
        f' conaffinity="2" friction="0.5 0.005 0.0001" priority="1" {soft} condim="3"'
        ' rgba=".62 .50 .38 1"/>'
    )


def _actuators(scene: SceneParams) -> str:
    text = ""
    stiffness = [*np.array(STIFFNESS_N_m) * scene.stiffness_scale, *[ROTATION_Nm_rad] * 3]
    inertia = [EFFECTIVE_MASS_kg] * 3 + [EFFECTIVE_INERTIA_kgm2] * 3
    nominal = [*STIFFNESS_N_m, *[ROTATION_Nm_rad] * 3]
    for axis in range(6):
        damping = 2 * DAMPING_RATIO * np.sqrt(nominal[axis] * inertia[axis]) * scene.damping_scale
        text += (
            f'<general site="tcp" refsite="base_tool" gear="{_text(np.eye(6)[axis])}"'
            f' biastype="affine" gainprm="{stiffness[axis]}"'
            f' biasprm="0 {-stiffness[axis]} {-damping}"/>'
        )
    grip = GRIPPER_N_m * scene.gripper_gain
    text += (
        f'<general tendon="width" biastype="affine" gainprm="{grip}" biasprm="0 {-grip} -20"'
        f' forcerange="-{GRIPPER_FORCE_N} {GRIPPER_FORCE_N}"/>'
    )
    return text


def build_mjcf(
    scene: SceneParams, left_sensor: str, right_sensor: str, solver: SolverSettings
) -> str:
    """Return the MJCF of a scene wearing the two named sensors."""
    opening, closing = _arm(scene)
    layout = scene.level.layout
    reference = (*layout.board_center_m, layout.carry_height_m)
    return f"""
<mujoco model="uniforce_wiping">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{solver.timestep_s}" integrator="implicitfast" cone="elliptic" impratio="10"
          jacobian="dense" solver="Newton" noslip_iterations="{solver.noslip_iterations}"/>
  <visual><quality shadowsize="0" offsamples="0"/><global offwidth="448" offheight="448"/></visual>
  <default><default class="visual"><geom contype="0" conaffinity="0" group="1"/></default></default>
  <worldbody>
    <light pos="0.6 0.3 1.5" dir="-0.1 -0.2 -1" castshadow="false"/>
    <geom name="pedestal" type="cylinder" size="0.09 0.07" pos="0 0 0.07" class="visual"
          rgba=".8 .8 .82 1"/>
    <site name="base_tool" pos="{_text(reference)}" euler="{np.pi} 0 0"/>
    {_board(scene)}{_eraser(scene)}{opening}{_tool(scene, (left_sensor, right_sensor))}{closing}
  </worldbody>
  <tendon><fixed name="width">
    <joint joint="finger_left" coef="1"/><joint joint="finger_right" coef="1"/>
  </fixed></tendon>
  <equality><joint joint1="finger_left" joint2="finger_right"/></equality>
  <actuator>{_actuators(scene)}</actuator>
</mujoco>"""
