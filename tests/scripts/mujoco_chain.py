#!/usr/bin/env python3
"""The arm's free chain in MuJoCo, beside the simulator's own plant and kinematics.

Requirements: mujoco==4.0.0 numpy==2.4.6 (Python 3.11 or newer)

    TROCAR_CHAIN_DUMP=$PWD/target/ours.toml cargo test -p trocar-world --lib world::tests::mujoco
    python tests/scripts/mujoco_chain.py target/ours.toml tests/golden/mujoco_chain.toml

The first command writes the parameters and what our side does with them; this script reads nothing else of ours. It makes a
MuJoCo model of the parameters, gives it the same loads, says how far the two are apart, writes MuJoCo's numbers to the second
file, and fails beyond the tolerances below. The same test compares our side with that file in CI, without MuJoCo.

What is compared. Our plant has no link inertias: each drive has a constant reflected inertia, viscous and Coulomb friction,
no gravity, and four discs that move the last joints and the jaw through a matrix. So the model's links weigh nothing to
speak of (1e-9 kg); its first three joints have armature, damping and frictionloss, and each disc is a fixed tendon over the
joints that it moves, with armature, damping and frictionloss of its own. MuJoCo thus finds by itself the chain's poses from
bodies and hinges, the joint loads of a force at the tip, the mass matrix of the coupled discs, and its own integration (a
twentieth of our millisecond, implicit). Left out: the mechanical end stops, which no run reaches.

  static   no motion: the tip's pose, and the joint efforts of a force and a moment there
  torque   drives off, a torque on every joint and the jaw
  force    drives off, a force and a moment at the tip, fixed in direction while the arm moves under it
  drive    drives on: joint controllers on encoder counts, effort and current limits, and a step on every axis

What the two differ by is time: our drives advance by a quarter of a millisecond, semi-implicitly, and loads change once in a
millisecond. With steps a tenth of that, the run "torque" comes within 0.03 % of each axis' way. MuJoCo's frictionloss is a
constraint that slips a little where Coulomb friction sticks. Figures of the last run are at the top of the written file.
"""

import sys
import tomllib

import mujoco
import numpy as np

SUBSTEP_S = 5e-5
AXES = 7
JOINTS = 6
NAMES = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"]
# Difference as a share of the way that an axis goes in a run; of an axis that friction holds, of this way, rad (m).
WAY_TOLERANCE = 0.01
WAY_LEAST = 1e-3
TIP_TOLERANCE_M = 1e-4
# Of what is not integrated: loads of a force at the tip, N m (N), and the tip itself, m and parts of a unit quaternion.
STATIC_TOLERANCE = 1e-8


def quaternion(matrix):
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.asarray(matrix, dtype=float).flatten())
    return found


def turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    if axis == "x":
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def text(numbers):
    return " ".join(f"{x:.17g}" for x in np.asarray(numbers, dtype=float).flatten())


def model_text(p):
    """MJCF of the chain: nested links of the table, tendons for the discs."""
    inertial = '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
    friction = 'solreffriction="2e-4 1" solimpfriction="0.9999 0.9999 1e-6 0.5 2"'
    opening, closing = "", ""
    for joint, (alpha, a, d, theta, slides) in enumerate(p["dh"]):
        place = np.array([a, 0, 0]) + turn("x", alpha) @ np.array([0, 0, d])
        rotation = turn("x", alpha) @ turn("z", theta)
        own = ""
        if joint < 3:
            own = (
                f'armature="{p["inertia"][joint]}" damping="{p["viscous"][joint]}" '
                f'frictionloss="{p["coulomb"][joint]}" {friction}'
            )
        opening += f'<body name="{NAMES[joint]}_link" pos="{text(place)}" quat="{text(quaternion(rotation))}">{inertial}'
        opening += f'<joint name="{NAMES[joint]}" type="{"slide" if slides else "hinge"}" axis="0 0 1" {own}/>'
        closing += "</body>"
    tip = quaternion(p["tip_from_wrist_yaw"])
    opening += f'<body name="tip" quat="{text(tip)}">'
    opening += f'<body name="finger">{inertial}<joint name="jaw" type="hinge" axis="1 0 0"/></body></body>'
    # disc = inverse(coupling) * (roll, wrist pitch, wrist yaw, jaw)
    rows = np.linalg.inv(np.array(p["coupling"]))
    tendons, motors = "", ""
    for disc, row in enumerate(rows):
        parts = "".join(
            f'<joint joint="{name}" coef="{share:.17g}"/>' for name, share in zip(NAMES[3:], row) if abs(share) > 1e-12
        )
        tendons += (
            f'<fixed name="disc{disc}" armature="{p["inertia"][3 + disc]}" damping="{p["viscous"][3 + disc]}" '
            f'frictionloss="{p["coulomb"][3 + disc]}" {friction}>{parts}</fixed>'
        )
        motors += f'<motor tendon="disc{disc}"/>'
    motors = "".join(f'<motor joint="{name}"/>' for name in NAMES[:3]) + motors
    return f"""<mujoco><compiler angle="radian"/>
<option timestep="{SUBSTEP_S}" gravity="0 0 0" integrator="implicitfast" tolerance="1e-12" iterations="100">
<flag contact="disable"/></option>
<worldbody>{opening}{closing}</worldbody><tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"""


class Chain:
    """The model at a start, advanced a millisecond at a time."""

    def __init__(self, parameters, start):
        self.p = {key: np.array(value) for key, value in parameters.items()}
        self.model = mujoco.MjModel.from_xml_string(model_text(parameters))
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = start
        mujoco.mj_forward(self.model, self.data)
        self.tip = self.model.body("tip").id

    def actuators(self, joints):
        discs = np.linalg.solve(self.p["coupling"], joints[3:])
        return np.concatenate([joints[:3], discs])

    def controller(self, target):
        """Actuator efforts of the shipped joint controllers towards actuator positions at rest."""
        p = self.p
        quantum = 2 * np.pi / p["encoder_counts"] / p["gear_ratio"]
        counted = np.round(self.actuators(self.data.qpos) / quantum) * quantum
        wanted = p["p"] * (target - counted) - p["d"] * self.actuators(self.data.qvel)
        transposed = p["coupling"].T
        joint = np.concatenate([wanted[:3], np.linalg.solve(transposed, wanted[3:])])
        joint = np.clip(joint, -p["effort_max"], p["effort_max"])
        actuator = np.concatenate([joint[:3], transposed @ joint[3:]])
        limit = p["current_max"] * p["torque_constant"] * p["gear_ratio"]
        return np.clip(actuator, -limit, limit)

    def millisecond(self, torque=None, wrench=None, target=None):
        for substep in range(round(1e-3 / SUBSTEP_S)):
            self.data.qfrc_applied[:] = 0 if torque is None else torque
            if wrench is not None:
                point = self.data.xpos[self.tip].copy()
                mujoco.mj_applyFT(
                    self.model, self.data, wrench[:3], wrench[3:], point, self.tip, self.data.qfrc_applied
                )
            # The drives' controllers run four times in a millisecond.
            if target is not None and substep % 5 == 0:
                self.data.ctrl[:] = self.controller(target)
            mujoco.mj_step(self.model, self.data)

    def pose(self):
        mujoco.mj_kinematics(self.model, self.data)
        rotation = self.data.xquat[self.tip]
        return np.concatenate([self.data.xpos[self.tip], rotation[1:], rotation[:1]])


def waves(table, millisecond):
    """A wave for each number: amplitude * cos(2 pi frequency t)."""
    t = 1e-3 * millisecond
    return np.array(table["amplitude"]) * np.cos(2 * np.pi * np.array(table["frequency_hz"]) * t)


def simulate(parameters, run):
    chain = Chain(parameters, run["start"])
    joints, tips = [], []
    for millisecond in range(run["milliseconds"]):
        load = waves(run, millisecond) if "amplitude" in run else None
        target = chain.actuators(np.array(run["target"])) if "target" in run else None
        chain.millisecond(
            torque=load if run["kind"] == "torque" else None,
            wrench=load if run["kind"] == "force" else None,
            target=target,
        )
        if (millisecond + 1) % run["sample_ms"] == 0:
            joints.append(chain.data.qpos.copy())
            tips.append(chain.pose())
    return np.array(joints), np.array(tips)


def static(parameters, case):
    """Joint efforts of a wrench at the tip, by the transposed Jacobian, and the tip."""
    chain = Chain(parameters, [*case["joints"], 0.0])
    wrench = np.array(case["wrench"])
    efforts = np.zeros(AXES)
    point = chain.data.xpos[chain.tip]
    mujoco.mj_applyFT(chain.model, chain.data, wrench[:3], wrench[3:], point, chain.tip, efforts)
    tip = chain.pose()
    return efforts[:JOINTS], tip * np.sign(tip @ np.array(case["tip"]))


def compare(run, joints, tips):
    """Largest differences: as a share of each axis' way, and of the tip, m and rad."""
    ours = np.array(run["joints"])
    way = np.ptp(np.vstack([run["start"], joints]), axis=0).clip(WAY_LEAST)
    share = np.abs(ours - joints).max(axis=0) / way
    tip = np.linalg.norm(np.array(run["tips"])[:, :3] - tips[:, :3], axis=1).max()
    alike = np.abs(np.sum(np.array(run["tips"])[:, 3:] * tips[:, 3:], axis=1)).clip(0, 1)
    return way, share, tip, 2 * np.arccos(alike).max()


def rows(name, table):
    lines = ",\n".join("  [" + ", ".join(f"{x:.12g}" for x in row) + "]" for row in table)
    return f"{name} = [\n{lines},\n]\n"


def main():
    ours_path, golden_path = sys.argv[1:]
    with open(ours_path, "rb") as file:
        ours = tomllib.load(file)
    figures, body, good = [], "", True
    body += "[parameters]\n"
    for key, value in ours["parameters"].items():
        body += f"{key} = {value}\n"
    for case in ours["static"]:
        efforts, tip = static(ours["parameters"], case)
        apart = max(np.abs(efforts - case["efforts"]).max(), np.abs(tip - case["tip"]).max())
        good &= apart <= STATIC_TOLERANCE
        figures.append(f"static: tip and joint efforts of a force there apart by at most {apart:.1e}")
        print(figures[-1], "" if apart <= STATIC_TOLERANCE else "TOO FAR")
        body += f"\n[[static]]\njoints = {case['joints']}\nwrench = {case['wrench']}\n"
        body += f"efforts = {efforts.tolist()}\ntip = {tip.tolist()}\n"
    for run in ours["run"]:
        joints, tips = simulate(ours["parameters"], run)
        way, share, tip, angle = compare(run, joints, tips)
        fine = share.max() <= WAY_TOLERANCE and tip <= TIP_TOLERANCE_M
        good &= fine
        figures.append(
            f"{run['kind']}: ways {', '.join(f'{x:.3g}' for x in way)}; apart by at most {share.max():.2%} of a way "
            f"({NAMES[share.argmax()]}), tip {tip * 1e6:.1f} um, {angle * 1e3:.3f} mrad"
        )
        print(figures[-1], "" if fine else "TOO FAR")
        body += "\n[[run]]\n"
        for key in ["kind", "milliseconds", "sample_ms", "start", "amplitude", "frequency_hz", "target"]:
            if key in run:
                value = run[key]
                body += f'{key} = "{value}"\n' if isinstance(value, str) else f"{key} = {value}\n"
        body += rows("joints", joints) + rows("tips", tips)
    with open(golden_path, "w", encoding="utf-8") as file:
        file.write(f"# Written by tests/scripts/mujoco_chain.py with MuJoCo {mujoco.__version__}; not to be edited.\n")
        for figure in figures:
            file.write(f"# {figure}\n")
        file.write("\n" + body)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
