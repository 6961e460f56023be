"""A spec that presses into the air above a board, as a file: what waits for its contact, or never meets one."""

from __future__ import annotations

PRESS = """
title: Press from the air
robot: panda
tool: chalk
scene: board
rate: 1000
duration: {duration}
references:
  above: {{line: {{in: board, from: [-0.06, -0.05, {height}], to: [-0.06, -0.05, {height}], time: 1}}}}
contacts:
  board:
    frame: chalk
    in: on
    natural:    {{fx: 0, fy: 0, mx: 0, my: 0, mz: 0, vz: 0}}
    artificial: {{vx: 0, vy: 0, wx: 0, wy: 0, wz: 0, fz: {force}}}
tasks:
  hover:   {{type: motion, frame: chalk, target: above, kp: 100, kd: 20}}
  press:   {{type: force, contact: board{gains}}}
  stay:    {{type: motion, contact: board, kp: 100, kd: 20}}
  posture: {{type: posture, target: start, kp: 50, kd: 10}}
phases:
  ready: {{contacts: [], tasks: [hover, posture], until: {{time: 0.002}}}}
  press: {{contacts: [board], tasks: [press, stay, posture]}}
limits: {{torque: model, torque_rate: 1000, position: model, velocity: model}}
plant: {{delay: {delay}}}
"""


def pressing(folder, height, force, gains=None, duration=1.0, delay=0):
    """The file: so high [m] above the board, with a force [N] and other keys of its task, and a delay [ticks]."""
    path = folder / "press.yaml"
    given = {"height": height, "force": force, "duration": duration, "delay": delay}
    path.write_text(PRESS.format(gains="".join(f", {key}: {value}" for key, value in (gains or {}).items()), **given))
    return path
