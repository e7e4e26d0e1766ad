"""A bicycle with a rider who pedals: one body, of which wheels, cranks and limbs move."""

from __future__ import annotations

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, visible_geom
from simbench.motion import pose
from simbench.randomise import hue_rgba, set_texture
from simbench.scenes_builtin.bodies import add_hinged
from simbench.scenes_builtin.gait import arm_angles, leg_angles
from simbench.scenes_builtin.people import SIDES, Figure, add_person
from slam.geometry import se3
from slam.geometry.arrays import Array

WHEEL_M = 0.34                  # radius
_AXLES_M = (-0.46, 0.56)        # x of the wheels' middles
_CRANK_AT = np.array([-0.06, 0.0, 0.29])
_CRANK_M = 0.17                 # from the middle to a pedal
_PEDAL_M = 0.11                 # of a pedal's middle sideways
_GRIP = np.array([0.40, 0.24, 1.02])      # of the left hand
_ANKLE_OVER_PEDAL = np.array([-0.09, 0.0, 0.10])
_LEAN_RAD = 0.55
_REST_RAD = 0.6                 # of the cranks, from straight ahead, where nobody pedals
_SIDES = 24


def add_cyclist(spec: mujoco.MjSpec, name: str, rng: np.random.Generator, limbs: float) -> Figure:
    """A cyclist as a child of the world: x forward, origin on the ground below the cranks.

    Hinges are "<name> front wheel", "... rear wheel", "... crank", and those of a person of the
    name "<name> rider".

    Args:
        limbs: share of a crank's usual length; 0: the feet stay where they are, and it is rigid.
    """
    paint = spec.add_material(name=f"{name} paint", rgba=hue_rgba(
        rng.uniform(), rng.uniform(0.3, 0.8), rng.uniform(0.5, 1.0)), specular=0.2)
    set_texture(paint, "paint")
    for look, rgba in (("tyre", [0.16, 0.16, 0.17, 1.0]), ("steel", [0.62, 0.63, 0.66, 1.0])):
        set_texture(spec.add_material(name=f"{name} {look}", rgba=rgba, specular=0.0), "concrete")
    meshes = {"frame": _frame(), "fittings": _fittings(), "crank": _crank(limbs),
              "tyre": _tyre(), "spokes": _spokes()}
    for part, builder in meshes.items():
        builder.add_to(spec, f"{name} {part}")
    body = spec.worldbody.add_body(name=name)
    visible_geom(body, f"{name} frame", paint.name)
    visible_geom(body, f"{name} fittings", f"{name} tyre")
    for wheel, x in (("rear wheel", _AXLES_M[0]), ("front wheel", _AXLES_M[1])):
        turning = add_hinged(body, f"{name} {wheel}", [x, 0.0, WHEEL_M],
                             {f"{name} {wheel}": [0.0, 1.0, 0.0]})
        visible_geom(turning, f"{name} tyre", f"{name} tyre")
        visible_geom(turning, f"{name} spokes", f"{name} steel")
    crank = add_hinged(body, f"{name} crank", _CRANK_AT, {f"{name} crank": [0.0, 1.0, 0.0]})
    visible_geom(crank, f"{name} crank", f"{name} steel")
    figure = Figure(float(rng.uniform(1.66, 1.84)))
    rider = add_person(spec, f"{name} rider", figure, rng, parent=body)
    rider.pos = _saddle(figure)
    return figure


def cyclist_angles(name: str, figure: Figure, travelled_m: float, pedalled_rad: float, limbs: float
                   ) -> dict[str, float]:
    """All joints of a cyclist.

    Args:
        travelled_m: which turns the wheels.
        pedalled_rad: by which the cranks have turned.
        limbs: as `add_cyclist` was given it.
    """
    # Turning wheels would outweigh all that the dial does: below 1 they slide.
    rider, rolled = f"{name} rider", travelled_m / WHEEL_M if limbs == 1.0 else 0.0
    turn = (pedalled_rad if limbs > 0.0 else 0.0) + _REST_RAD
    sway = limbs * np.sin(turn)
    angles = {f"{name} front wheel": rolled, f"{name} rear wheel": rolled, f"{name} crank": turn,
              f"{rider} lean": _LEAN_RAD, f"{rider} twist": 0.05 * float(sway),
              f"{rider} nod": -0.42, f"{rider} look": 0.06 * float(sway)}
    T_bike_pelvis = pose(_saddle(figure))
    for side, sign in SIDES.items():
        c, s = sign * np.cos(turn), -sign * np.sin(turn)       # the pedals are opposite
        pedal = _CRANK_AT + limbs * _CRANK_M * np.array([c, 0.0, s])
        ankle = pedal + _ANKLE_OVER_PEDAL + np.array([0.0, sign * _PEDAL_M, 0.0])
        angles |= leg_angles(rider, side, figure, T_bike_pelvis, ankle, 0.18)
        angles |= _reaching_arm(rider, side, figure, T_bike_pelvis, _GRIP * [1.0, sign, 1.0],
                                angles[f"{rider} twist"])
    return angles


def _reaching_arm(rider: str, side: str, figure: Figure, T_bike_pelvis: Array, grip: Array,
                  twist: float) -> dict[str, float]:
    """Shoulder and elbow that bring the hand to the grip (3,)."""
    k = figure.scale
    T_pelvis_chest = pose([0.0, 0.0, 0.08 * k], pitch=_LEAN_RAD) @ pose(np.zeros(3), twist)
    shoulder = np.array([0.0, SIDES[side] * 0.2 * k, 0.415 * k])
    x, y, z = se3.transform_points(se3.inverse(T_bike_pelvis @ T_pelvis_chest),
                                   grip[None])[0] - shoulder
    upper, lower = 0.29 * k, 0.34 * k
    down = float(np.hypot(y, z))
    reach = min(float(np.hypot(x, down)), 0.999 * (upper + lower))
    bend = np.pi - np.arccos((upper**2 + lower**2 - reach**2) / (2.0 * upper * lower))
    behind = np.arccos(np.clip((upper**2 + reach**2 - lower**2) / (2.0 * upper * reach), -1.0, 1.0))
    straight = np.arctan2(-x, -z)
    return arm_angles(rider, side, float(straight + behind), 0.0, float(-bend))


def _saddle(figure: Figure) -> Array:
    """(3,) m: between the hips of a rider, whose legs are nearly straight at the lowest pedal."""
    return np.array([-0.27, 0.0, 0.30 + 0.83 * (figure.thigh + figure.shank)])


def _bar(builder: MeshBuilder, a: tuple[float, float, float], b: tuple[float, float, float],
         thick: float) -> None:
    """A square bar from a to b."""
    start, end = np.array(a), np.array(b)
    along = (end - start) / np.linalg.norm(end - start)
    across = np.cross(along, [0.0, 1.0, 0.0] if abs(along[1]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    R = np.stack([along, across, np.cross(along, across)], axis=-1)
    builder.box(0.5 * (start + end), (float(np.linalg.norm(end - start)), thick, thick), R,
                scale=2.0)


def _frame() -> MeshBuilder:
    builder = MeshBuilder()
    rear, front = _AXLES_M
    seat, head, crank = (-0.24, 0.0, 0.80), (0.38, 0.0, 0.82), tuple(_CRANK_AT)
    for a, b in ((crank, seat), (seat, head), (crank, (0.42, 0.0, 0.70))):
        _bar(builder, a, b, 0.038)
    _bar(builder, (0.36, 0.0, 0.94), (0.43, 0.0, 0.66), 0.042)
    for y in (-0.055, 0.055):
        _bar(builder, (rear, y, WHEEL_M), (-0.22, y * 0.5, 0.76), 0.022)
        _bar(builder, (rear, y, WHEEL_M), (crank[0], y * 0.7, crank[2]), 0.022)
        _bar(builder, (front, y, WHEEL_M), (0.43, y * 0.7, 0.69), 0.026)
    return builder


def _fittings() -> MeshBuilder:
    """Saddle and handlebar."""
    builder = MeshBuilder()
    _bar(builder, (-0.24, 0.0, 0.78), (-0.27, 0.0, 0.93), 0.03)
    builder.box((-0.27, 0.0, 0.94), (0.26, 0.15, 0.05), scale=2.0)
    _bar(builder, (0.36, 0.0, 0.90), (0.34, 0.0, 1.00), 0.03)
    _bar(builder, (0.34, 0.0, 0.99), (0.40, 0.0, 1.00), 0.03)
    _bar(builder, (0.40, -0.29, 1.00), (0.40, 0.29, 1.00), 0.028)
    return builder


def _crank(limbs: float) -> MeshBuilder:
    """Chain wheel, cranks and pedals, the left one ahead."""
    builder = MeshBuilder()
    angle = 2.0 * np.pi * np.arange(13) / 12
    ring = 0.09 * np.stack([np.cos(angle), np.zeros(13), np.sin(angle)], axis=-1)
    for y, flip in ((-0.035, 1), (-0.045, -1)):
        rim = (ring + np.array([0.0, y, 0.0]))[::flip]
        middle = np.broadcast_to([0.0, y, 0.0], rim[:-1].shape)
        builder.quads(np.stack([middle, rim[:-1], rim[1:], rim[1:]], axis=1)[:, ::-1], scale=2.0)
    for sign in (1.0, -1.0):
        x = sign * limbs * _CRANK_M
        if limbs > 0.0:
            _bar(builder, (0.0, sign * 0.06, 0.0), (x, sign * 0.06, 0.0), 0.026)
        builder.box((x, sign * _PEDAL_M, 0.0), (0.09, 0.10, 0.025), scale=2.0)
    return builder


def _tyre() -> MeshBuilder:
    """A ring of square section about the y axis."""
    angle = 2.0 * np.pi * np.arange(_SIDES + 1) / _SIDES
    circle = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    half = np.array([0.0, 0.019, 0.0])
    out, inside = WHEEL_M * circle, (WHEEL_M - 0.038) * circle
    builder = MeshBuilder()
    for a, b in ((out + half, out - half), (out - half, inside - half),
                 (inside - half, inside + half), (inside + half, out + half)):
        builder.quads(np.stack([a[1:], b[1:], b[:-1], a[:-1]], axis=1), scale=2.0)
    return builder


def _spokes() -> MeshBuilder:
    builder = MeshBuilder()
    for angle in np.pi * np.arange(6) / 6.0:
        end = (WHEEL_M - 0.03) * np.array([np.cos(angle), 0.0, np.sin(angle)])
        _bar(builder, tuple(-end), tuple(end), 0.008)
    builder.box((0.0, 0.0, 0.0), (0.05, 0.09, 0.05), scale=2.0)
    return builder
