"""Physics of one scene: targets in, one 30 Hz step of MuJoCo, measured pose and touch truth out."""

from dataclasses import dataclass

import mujoco
import numpy as np

from lerobot_env_uniforce_wiping.gripper import FrankaHand, Gripper, Servo, finger_addresses
from lerobot_env_uniforce_wiping.hidden import UnevenBoard, hand_pull
from lerobot_env_uniforce_wiping.ink import InkField
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.mjcf import READS, TOOL_DOWN, SolverSettings, build_mjcf
from lerobot_env_uniforce_wiping.scene_params import SceneParams
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.sensors import get_sensor

LEASH_m = 0.018  # targets stay this close to the measured tool: bounds the force of any command
LEASH_rad = 0.20
# m/s, m/s, m/s, rad/s, m/s of the inner target
SPEED_LIMITS = np.array([0.15, 0.15, 0.10, 1.0, 0.15])
WIDTH_RANGE_m = (0.0, 0.08)
YAW_RANGE_rad = (-0.5, 0.5)
GEL_D = 0.5  # solimp d: converged in the time step, no chatter
GEL_ZETA = 0.7  # damping ratio
IK_DAMPING = 0.05**2 * 1e-2  # of the arm's pose at reset
IK_STEP_rad = 0.3  # largest joint change per iteration
# joint angles, rad
HOME_q = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
# A pad's canonical image frame in the world: x = +y, y = −z, z into the pad, along this sign of x.
INTO_PAD_x = {"left": -1.0, "right": 1.0}


@dataclass(frozen=True)
class PadTruth:
    """Contact of one pad, averaged over a step.

    ``wrench`` is canonical: fx, fy, fz in N, torsion in Nmm; ``depth_mm`` is the mean indentation.
    """

    wrench: np.ndarray
    depth_mm: float


class WipeSimulation:
    """One compiled scene; everything is in the robot base frame unless named otherwise.

    Args:
        scene: its numbers.
        left_sensor: sensor type on the left finger.
        right_sensor: sensor type on the right finger.
        solver: settings of the physics.
        stiffness: left and right unit's stiffness over its type's nominal one.
        gripper: one of ``gripper.GRIPPERS``.
    """

    def __init__(
        self,
        scene: SceneParams,
        left_sensor: str,
        right_sensor: str,
        solver: SolverSettings | None = None,
        stiffness: tuple[float, float] = (1.0, 1.0),
        gripper: str = "hand",
    ) -> None:
        self.scene = scene
        self.solver = solver or SolverSettings()
        self.sensors = {"left": left_sensor, "right": right_sensor}
        self.model = mujoco.MjModel.from_xml_string(
            build_mjcf(scene, left_sensor, right_sensor, self.solver)
        )
        self.data = mujoco.MjData(self.model)
        self.ink = InkField(scene)
        self._find_ids()
        self._set_pad_stiffness(dict(zip(FINGERS, stiffness, strict=True)))
        self._draw_hidden()
        self._place_arm()
        self.gripper = self._make_gripper(gripper)
        self._apply(self.target)
        mujoco.mj_forward(self.model, self.data)
        self.pads = {f: PadTruth(np.zeros(4, np.float32), 0.0) for f in FINGERS}
        self.press_N = self.slide_m = 0.0
        self.push_N = np.zeros(3)  # on the hand, besides the scene's pull
        self._felt_before = self._felt_on_board()

    def _find_ids(self) -> None:
        m = self.model
        self._pad_geom: dict[int, Finger] = {m.geom(f"pad_{f}").id: f for f in FINGERS}
        self._skin = {f: m.geom(f"skin_{f}").id for f in FINGERS}
        self._role = np.zeros(m.ngeom, dtype=np.int64)
        self._role[[*self._pad_geom, m.geom("board").id]] = (1, 2, 3)
        self._eraser = m.body("eraser").id
        self._tcp = m.site("tcp").id
        self._hand = m.body("hand").id
        self._board = m.geom("board").id
        self._board_body = m.body("board").id
        self._reference = m.site("base_tool").pos.copy()

    def _set_pad_stiffness(self, over_nominal: dict[Finger, float]) -> None:
        """Set solref so that pads have their stiffness K whatever the eraser weighs."""
        weight = self.model.body_invweight0
        pads = self.scene.level.pads
        for geom, finger in self._pad_geom.items():
            if get_sensor(self.sensors[finger]).dome_radius_mm is None:
                nominal = pads.flat_N_mm
                points = 4  # a box touches at its corners
            else:
                nominal = pads.dome_N_mm
                points = 1
            K = min(nominal * over_nominal[finger], pads.stiffest_N_mm) * 1000
            mobility = weight[self.model.geom_bodyid[geom], 0] + weight[self._eraser, 0]
            stiffness = K / points * (1 - GEL_D) * mobility
            damping = 2 * GEL_ZETA * np.sqrt(stiffness * GEL_D)
            self.model.geom_solref[geom] = (-stiffness, -damping)

    def _draw_hidden(self) -> None:
        level = self.scene.level
        seed = self.scene.seed
        steps = round(level.time_limit_s * CONTROL_HZ)
        self._pull_N = (
            hand_pull(seed, level.pull, steps, CONTROL_HZ) if level.pull else np.zeros((1, 3))
        )
        self._uneven = UnevenBoard(seed, level.uneven) if level.uneven else None
        self._flat_m = float(self.model.geom_pos[self._board, 2])
        self._steps = 0

    def _place_arm(self) -> None:
        layout = self.scene.level.layout
        offset = np.array(self.scene.start_offset_m)
        start = np.array([*layout.tray_m, layout.start_height_m]) + offset
        solve_arm(self.model, self.data, start, TOOL_DOWN)
        for address in finger_addresses(self.model):
            self.data.qpos[address] = layout.open_width_m / 2
        self.target = np.array([*start, 0.0, layout.open_width_m])

    def _make_gripper(self, name: str) -> Gripper:
        if name == "hand":
            return FrankaHand(self.model, self.data, self.scene.seed)
        return Servo(self.model, self.data, self.target[4], self.scene.gripper_dead_band_m)

    @property
    def measured(self) -> np.ndarray:
        """(5,) measured x, y, z, yaw, width: all a policy may know of the robot."""
        matrix = self.data.site_xmat[self._tcp].reshape(3, 3)
        yaw = np.arctan2(matrix[1, 0], matrix[0, 0])
        return np.array([*self.data.site_xpos[self._tcp], yaw, self.gripper.width_m])

    def command(self, action: np.ndarray) -> None:
        """Move the inner target towards an absolute target: speed-limited, leashed, in range."""
        limit = SPEED_LIMITS / CONTROL_HZ
        target = self.target + np.clip(action - self.target, -limit, limit)
        measured = self.measured
        target[:3] = np.clip(target[:3], measured[:3] - LEASH_m, measured[:3] + LEASH_m)
        target[3] = np.clip(target[3], *YAW_RANGE_rad)
        target[3] = np.clip(target[3], measured[3] - LEASH_rad, measured[3] + LEASH_rad)
        target[4] = np.clip(target[4], *WIDTH_RANGE_m)
        self.target = target
        self._apply(target)

    def _apply(self, target: np.ndarray) -> None:
        self.data.ctrl[:3] = TOOL_DOWN @ (target[:3] - self._reference)
        self.data.ctrl[3:6] = (0.0, 0.0, -target[3])
        self.gripper.command(target[4])

    def step(self) -> None:
        """Advance 1/30 s, averaging touch over the step and wearing ink."""
        forces = {f: np.zeros(5) for f in FINGERS}  # fx, fy, fz, torsion, depth
        press = np.zeros(3)
        self.data.xfrc_applied[self._hand, :3] = (
            self._pull_N[self._steps % len(self._pull_N)] + self.push_N
        )
        self._steps += 1
        for _ in range(READS):
            self._raise_board()
            self.gripper.advance(1 / CONTROL_HZ / READS)
            mujoco.mj_step(self.model, self.data, self.solver.substeps)
            self._read_contacts(forces, press)
        for finger in FINGERS:
            mean = forces[finger] / READS
            self.pads[finger] = PadTruth(mean[:4].astype(np.float32), float(mean[4]))
        self.press_N = press[0] / READS
        self._wear(press)

    def _raise_board(self) -> None:
        """Move the whole board to its height under the eraser's middle."""
        if self._uneven is not None:
            height_m = self._uneven.height_m(self._felt_on_board()[0])
            self.model.geom_pos[self._board, 2] = self._flat_m + height_m

    def _read_contacts(self, forces: dict[Finger, np.ndarray], press: np.ndarray) -> None:
        """Add one sample of every contact's force to the sums; elliptic cones: it is efc_force."""
        contact = self.data.contact
        if len(contact.geom) == 0:
            return
        role = self._role[contact.geom]  # (C, 2): 0 other, 1 left pad, 2 right pad, 3 board
        kind = role.max(axis=1)
        address = contact.efc_address
        # (C, 3) on geom2, contact frame
        local = self.data.efc_force[address[:, None] + np.arange(3)]
        frame = contact.frame.reshape(-1, 3, 3)
        for code, finger in enumerate(FINGERS, start=1):
            rows = np.flatnonzero((kind == code) & (address >= 0))
            if len(rows):
                # of the force on the pad, whichever comes first
                sign = np.where(role[rows, 0] == code, -1.0, 1.0)
                turn = self.data.efc_force[address[rows] + 3]
                world = (frame[rows].transpose(0, 2, 1) @ local[rows, :, None])[..., 0]
                world = world * sign[:, None]
                twist = frame[rows, 0, :] * (sign * turn)[:, None]
                forces[finger] += self._on_pad(
                    finger, contact.pos[rows], world, twist, contact.dist[rows]
                )
        rows = np.flatnonzero((kind == 3) & (address >= 0))
        if len(rows):
            at = self._in_eraser(contact.pos[rows])
            press += local[rows, 0] @ np.column_stack([np.ones(len(rows)), at[:, :2]])

    def _on_pad(
        self,
        finger: Finger,
        point: np.ndarray,
        force: np.ndarray,
        twist: np.ndarray,
        gap_m: np.ndarray,
    ) -> np.ndarray:
        """Return (5,) canonical fx, fy, fz N, torsion Nmm, mean depth mm of a pad's C contacts."""
        tool = self.data.site_xmat[self._tcp].reshape(3, 3)  # x closes, y = world −y, z down
        pad = self.data.geom_xpos[self._skin[finger]]
        pushes = force @ tool
        arms = (point - pad) @ tool
        total = pushes.sum(axis=0)
        moment_x = np.sum(
            arms[:, 1] * pushes[:, 2] - arms[:, 2] * pushes[:, 1] + twist @ tool[:, 0]
        )
        depth_mm = max(float(-gap_m.mean() * 1000), 0.0)
        # image x = world +y = tool −y, image y = world −z = tool z; torsion mirrors with the image
        return np.array(
            [-total[1], total[2], INTO_PAD_x[finger] * total[0], -moment_x * 1000, depth_mm]
        )

    def _in_eraser(self, points: np.ndarray) -> np.ndarray:
        rotation = self.data.xmat[self._eraser].reshape(3, 3)
        return (points - self.data.xpos[self._eraser]) @ rotation

    def _felt_on_board(self) -> tuple[np.ndarray, float]:
        """Return the felt's centre (2,) and yaw, in board coordinates."""
        board = self.data.xmat[self._board_body].reshape(3, 3)
        center = board.T @ (self.data.xpos[self._eraser] - self.data.xpos[self._board_body])
        axis = board.T @ self.data.xmat[self._eraser].reshape(3, 3)[:, 0]
        return center[:2].copy(), float(np.arctan2(axis[1], axis[0]))

    def _wear(self, press: np.ndarray) -> None:
        center, yaw = self._felt_on_board()
        before = self._felt_before[0]
        self._felt_before = (center, yaw)
        self.slide_m = float(np.linalg.norm(center - before))
        if press[0] <= 0:
            return
        size = np.array([self.scene.eraser_width_m, self.scene.eraser_length_m])
        mean = np.array([press[0] / READS, press[1] / press[0], press[2] / press[0]])
        self.ink.wipe((center + before) / 2, yaw, size, mean, self.slide_m)

    def block_from_pad(self, finger: Finger) -> tuple[np.ndarray, np.ndarray]:
        """Return the block's centre (3,) from a pad, m, and axes (3, 3) as columns; tool frame."""
        tool = self.data.site_xmat[self._tcp].reshape(3, 3)
        block = self.data.geom("block")
        center = tool.T @ (block.xpos - self.data.geom_xpos[self._skin[finger]])
        return center, tool.T @ block.xmat.reshape(3, 3)

    def eraser_in_tool(self) -> np.ndarray:
        """Return (3,) position of the eraser in the tool frame, m."""
        tool = self.data.site_xmat[self._tcp].reshape(3, 3)
        return tool.T @ (self.data.xpos[self._eraser] - self.data.site_xpos[self._tcp])


def solve_arm(
    model: mujoco.MjModel, data: mujoco.MjData, position_m: np.ndarray, rotation: np.ndarray
) -> None:
    """Set the arm's seven joints so that site ``tcp`` meets a pose, by damped least squares."""
    site = model.site("tcp").id
    first = model.joint("joint1")
    joints = slice(first.qposadr[0], first.qposadr[0] + len(HOME_q))
    columns = slice(first.dofadr[0], first.dofadr[0] + len(HOME_q))
    data.qpos[joints] = HOME_q
    jacobian = np.zeros((6, model.nv))
    for _ in range(60):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        turn = rotation @ data.site_xmat[site].reshape(3, 3).T
        axis = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        error = np.concatenate([position_m - data.site_xpos[site], np.array(axis) / 2])
        if np.linalg.norm(error) < 1e-6:
            break
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        J = jacobian[:, columns]
        step = J.T @ np.linalg.solve(J @ J.T + IK_DAMPING * np.eye(6), error)
        data.qpos[joints] += np.clip(step, -IK_STEP_rad, IK_STEP_rad)
