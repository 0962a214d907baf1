"""MuJoCo: the hinge chain in motion; its links have the mass of the whisker, its hinges the stiffness and the damping.

Rigid links of length h = 1/n, with half a link at either end, are joined by hinges of stiffness 1/h. The base stays at
the origin. A sweep moves the object instead, whose large mass keeps its speed; motion at constant speed is the same in
both frames. `mj_rnePostConstraint` yields the reaction at the base.

Without damping and contact, semi-implicit Euler steps (symplectic) need less time than RK4 for the same error. In the
sweep, the integrator `discrete` (implicit in stiffness, damping and contact) has smaller errors than `implicitfast`;
RK4 is explicit in the damping and needs far smaller steps. Harder contacts flicker when they pass from link to link,
and softer ones yield.
"""

import mujoco
import numpy as np

from peers.motion import RingDown, Sweep, substeps

THICKNESS = 1e-3  # radius of the capsules; the radius of the sphere is reduced by the same amount
HEAVY = 1e8  # mass of the object, whose speed contact forces then change by less than 1e-5 of itself
LARGEST = 0.2  # explicit step in h^2; the highest frequency of the chain is 6.9 / h^2
CONTACT = 'solref="0.001 1" solimp="0.9 0.9 0.001"'


def model(links: int, dt: float, integrator: str, sweep: Sweep | None = None) -> mujoco.MjModel:
    """Upright chain whose lowest half link is fixed; joints in order: hinges from base to tip, slide of the object."""
    h, chain, body = 1 / links, "", ""
    damping = 0.0 if sweep is None else sweep.stiffness_damping * links
    for number in reversed(range(links + 1)):
        length = h if 0 < number < links else h / 2
        turning = f"{length**3 / 12}"
        inertia = f'<inertial pos="0 {length / 2} 0" mass="{length}" diaginertia="{turning} {turning} {turning}"/>'
        shape = f'<geom type="capsule" size="{THICKNESS}" fromto="0 0 0 0 {length} 0"/>'
        joint = f'<joint axis="0 0 1" stiffness="{links}" damping="{damping}"/>' if number else ""
        above = 0 if number == 0 else h / 2 if number == 1 else h
        chain = f'<body pos="0 {above} 0">{joint}{inertia}{shape}{chain}</body>'
    if sweep is not None:
        centre = sweep.scene.distance + sweep.scene.radius
        body = f"""
            <body pos="{-sweep.start} {centre} 0">
              <joint type="slide" axis="1 0 0"/>
              <geom type="sphere" size="{sweep.scene.radius - THICKNESS}" mass="{HEAVY}" contype="2" conaffinity="1"/>
            </body>"""
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 0" timestep="{dt}" integrator="{integrator}"/>
          <default><geom condim="1" {CONTACT} contype="1" conaffinity="2"/></default>
          <worldbody>{chain}{body}</worldbody>
        </mujoco>""")


def ring_down(motion: RingDown, links: int) -> np.ndarray:
    """Tip x, y at all samples, (samples + 1, 2)."""
    steps = substeps(motion, LARGEST / links**2)
    chain = model(links, motion.duration / motion.samples / steps, "Euler")
    data = mujoco.MjData(chain)
    ends = motion.shape(np.array([0.0, *((np.arange(links) + 0.5) / links), 1.0]))[:, :2]
    chords = np.diff(ends, axis=0)
    angles = np.arctan2(chords[:, 1], chords[:, 0])
    data.qpos[:] = np.diff([np.pi / 2, *angles[1:]])  # the first half link is fixed upright
    tip = []
    for k in range(motion.samples + 1):
        if k:
            mujoco.mj_step(chain, data, steps)
        mujoco.mj_kinematics(chain, data)
        along = data.xmat[-1].reshape(3, 3)[:2, 1]
        tip.append(data.xpos[-1, :2] + along / (2 * links))
    return np.array(tip)


def sweep(motion: Sweep, links: int, steps: int) -> np.ndarray:
    """Support reactions fx, fy, mz at all samples but the first, (samples, 3), in `steps` steps between samples."""
    chain = model(links, motion.duration / motion.samples / steps, "discrete", motion)
    data = mujoco.MjData(chain)
    data.qvel[-1] = motion.speed
    reactions = []
    for _ in range(motion.samples):
        mujoco.mj_step(chain, data, steps)
        mujoco.mj_forward(chain, data)
        mujoco.mj_rnePostConstraint(chain, data)
        torque, force, centre = data.cfrc_int[1][:3], data.cfrc_int[1][3:], data.subtree_com[1]
        reactions.append((force[0], force[1], torque[2] + centre[0] * force[1] - centre[1] * force[0]))
    return np.array(reactions)
