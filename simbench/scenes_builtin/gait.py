"""How people move: a walk whose feet stand still while they carry, sitting, gestures, pushing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from simbench.motion import Wander, pose
from simbench.scenes_builtin.people import SIDES, Figure
from slam.geometry import se3
from slam.geometry.arrays import Array

Path = Callable[[float], tuple[Array, float]]   # arc length (m) to position (2,) and heading (rad)

STEP_SHARE = 0.33        # of the stature: from one footprint to the next
_STANCE = 0.6            # of a foot's cycle of two steps it stands
_ROLL = 0.42             # from there on its heel rises
_LEAD_SHARE = 0.16       # of the stature: how far before the hips a foot is put down
_HEEL_RAD = np.deg2rad(32.0)
_LIFT_M = 0.05           # of a swinging foot
_BALL_M = 0.11           # from the ankle forward to the ball, on which the foot rolls


@dataclass(frozen=True, slots=True)
class Walker:
    """A person who walks along a path."""

    name: str
    figure: Figure
    path: Path
    progress: Callable[[float], float]    # time (s) to arc length (m)
    pushes: bool = False                  # arms held out, as behind a chair
    floor_m: float = 0.0                  # height of the ground they walk on
    limbs: float = 1.0                    # share of the gait; 0: glides along, standing stiff

    @property
    def step_m(self) -> float:
        return STEP_SHARE * self.figure.stature

    def __call__(self, time_s: float) -> dict[str, Array | float]:
        """Pose and joint angles at that time."""
        s, k = self.progress(time_s), self.figure.scale
        position, heading = self.path(s)
        phase = np.pi * s / self.step_m              # a turn is two steps
        limbs = self.limbs
        height = self.floor_m + k * (0.876 - 0.014 * limbs * np.cos(2.0 * phase))
        T_world_pelvis = pose([*position, height], heading)
        swing = limbs * np.deg2rad(24.0) * np.sin(phase + 0.25 * np.pi)
        placed: dict[str, Array | float] = {
            self.name: T_world_pelvis, f"{self.name} lean": np.deg2rad(3.0 + 6.0 * self.pushes),
            f"{self.name} twist": -0.2 * swing, f"{self.name} nod": 0.04,
            f"{self.name} look": 0.12 * limbs * np.sin(0.31 * phase)}
        for number, (side, sign) in enumerate(SIDES.items()):
            ankle, turn, pitch = self._foot(s, number, sign)
            turn = (turn - heading + np.pi) % (2.0 * np.pi) - np.pi
            under = se3.transform_points(T_world_pelvis, np.array(
                [[0.02, sign * self.figure.hip, self.floor_m + self.figure.ankle - height]]))[0]
            ankle = limbs * ankle + (1.0 - limbs) * under
            placed |= leg_angles(self.name, side, self.figure, T_world_pelvis, ankle,
                                 limbs * pitch, limbs * turn)
            arm = -0.9 if self.pushes else sign * swing
            bend = -0.55 if self.pushes \
                else -0.35 - 0.2 * limbs * max(0.0, -np.sin(phase) * sign)
            placed |= arm_angles(self.name, side, arm, 0.06, bend)
        return placed

    def _foot(self, s: float, number: int, sign: float) -> tuple[Array, float, float]:
        """Ankle (3,) in the world, heading and pitch (rad, positive lowers the toes) of a foot."""
        figure, step = self.figure, self.step_m
        cycle = s / step / 2.0 - number / 2.0
        turn = np.floor(cycle)
        share = cycle - turn
        put_down = (2.0 * turn + number) * step + _LEAD_SHARE * figure.stature
        if share < _STANCE:
            pitch = _HEEL_RAD * _smooth((share - _ROLL) / (_STANCE - _ROLL))
            here, lift = self._footprint(put_down, sign), 0.0
        else:
            swung = (share - _STANCE) / (1.0 - _STANCE)
            along = _smooth(swung)
            a, b = (self._footprint(each, sign) for each in (put_down, put_down + 2.0 * step))
            turned = (b[2] - a[2] + np.pi) % (2.0 * np.pi) - np.pi
            here = np.array([*(a[:2] + along * (b[:2] - a[:2])), a[2] + along * turned])
            pitch = _HEEL_RAD * (1.0 - along) - 0.2 * np.sin(np.pi * swung) * swung
            lift = _LIFT_M * np.sin(np.pi * swung) ** 2
        # The foot turns on its ball, which stays where it is.
        rise, back = np.sin(max(pitch, 0.0)), 1.0 - np.cos(max(pitch, 0.0))
        ball, up = _BALL_M * figure.scale, figure.ankle
        forward = ball * back + up * rise
        xy = here[:2] + forward * np.array([np.cos(here[2]), np.sin(here[2])])
        ankle = self.floor_m + (up + ball * rise - up * back + lift)
        return np.array([*xy, ankle]), float(here[2]), float(pitch)

    def _footprint(self, s: float, sign: float) -> Array:
        """Position and heading (3,) of the footprint at that arc length."""
        position, heading = self.path(s)
        left = np.array([-np.sin(heading), np.cos(heading)])
        return np.array([*(position + 0.9 * sign * self.figure.hip * left), heading])


@dataclass(frozen=True, slots=True)
class Sitter:
    """A person on a chair who talks with hands and head."""

    name: str
    figure: Figure
    place: Array          # (3,) m: between the hips
    heading: float
    gestures: Wander      # (8,) rad: lean, twist, nod, look, shoulders, elbows
    limbs: float = 1.0    # share of the gestures; 0: sits stiff

    @classmethod
    def draw(cls, rng: np.random.Generator, name: str, figure: Figure, place: Array,
             heading: float, limbs: float = 1.0) -> Sitter:
        rms = np.deg2rad([4.0, 7.0, 5.0, 14.0, 15.0, 15.0, 18.0, 18.0])
        return cls(name, figure, place, heading, Wander.draw(rng, rms, (0.1, 0.9)), limbs)

    def __call__(self, time_s: float) -> dict[str, Array | float]:
        """Pose and joint angles at that time."""
        lean, twist, nod, look, *arms = (
            float(each) for each in self.limbs * self.gestures(time_s))
        T_world_pelvis = pose(self.place, self.heading)
        placed: dict[str, Array | float] = {
            self.name: T_world_pelvis, f"{self.name} lean": 0.03 + lean,
            f"{self.name} twist": twist, f"{self.name} nod": nod, f"{self.name} look": look}
        for number, (side, sign) in enumerate(SIDES.items()):
            foot = T_world_pelvis @ np.array([
                self.figure.thigh + 0.02, 1.3 * sign * self.figure.hip,
                self.figure.ankle - self.place[2], 1.0])
            placed |= leg_angles(self.name, side, self.figure, T_world_pelvis, foot[:3], 0.0)
            placed |= arm_angles(self.name, side, -0.45 + arms[number], 0.12,
                                 -1.25 + arms[2 + number])
            placed[f"{self.name} {side} spread"] = sign * 0.15
        return placed


def leg_angles(name: str, side: str, figure: Figure, T_world_pelvis: Array, ankle_world: Array,
               pitch: float, turn: float = 0.0) -> dict[str, float]:
    """Hip, knee and ankle that put an ankle (3,) there, the foot level but for `pitch` (rad).

    Args:
        turn: rad by which the leg and its foot are turned outwards of the pelvis, about z.
    """
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    hip = np.array([0.0, SIDES[side] * figure.hip, 0.0])
    x, y, dz = se3.transform_points(se3.inverse(T_world_pelvis), ankle_world[None])[0] - hip
    dx, dy = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    down = float(np.hypot(dy, dz))
    a, b = figure.thigh, figure.shank
    reach = min(float(np.hypot(dx, down)), 0.9995 * (a + b))
    knee = np.pi - np.arccos((a * a + b * b - reach**2) / (2.0 * a * b))
    ahead = np.arccos(np.clip((a * a + reach**2 - b * b) / (2.0 * a * reach), -1.0, 1.0))
    thigh = np.arctan2(-dx, down) - ahead
    return {f"{name} {side} turn": float(turn), f"{name} {side} roll": float(np.arctan2(dy, -dz)),
            f"{name} {side} hip": float(thigh), f"{name} {side} knee": float(knee),
            f"{name} {side} ankle": float(pitch - thigh - knee)}


def arm_angles(name: str, side: str, shoulder: float, spread: float, elbow: float
               ) -> dict[str, float]:
    """Negative angles of shoulder and elbow (rad) bring the hand forward."""
    return {f"{name} {side} shoulder": float(shoulder), f"{name} {side} elbow": float(elbow),
            f"{name} {side} spread": SIDES[side] * spread}


class OpenPath:
    """A smooth way through points in the plane, by its arc length; straight on beyond its ends."""

    def __init__(self, points: Array) -> None:
        chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        fine = np.linspace(0.0, chord[-1], 400)
        xy = CubicSpline(chord, points)(fine)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        self.length_m = float(s[-1])
        self._xy = CubicSpline(s, xy)
        self._tangent = self._xy.derivative()

    def __call__(self, s_m: float) -> tuple[Array, float]:
        s = float(np.clip(s_m, 0.0, self.length_m))
        dx, dy = self._tangent(s)
        heading = float(np.arctan2(dy, dx))
        beyond = (s_m - s) * np.array([np.cos(heading), np.sin(heading)])
        return np.asarray(self._xy(s)) + beyond, heading


def _smooth(share: float) -> float:
    """0 to 1, at rest at both ends."""
    t = min(max(share, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)

