"""The robot's equations written a second time, from other principles than the plant's, for SciPy to integrate.

The plant works in the body frame with the twist of the robot's centre. Here the coordinates are the world's: the
centre of mass, the heading and the four wheel angles, each with its own inertia. Rollers that do not slip are four
constraints with Lagrange multipliers; rollers that slip are four forces. A vector of the ground plane is a complex
number, so that turning is multiplication by exp(i heading).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from tests.support.plant_testbed import DEFAULTS, GRIPS, SLIP, START, TORQUE, VOLTAGE, O, wheels

G = 9.81


@dataclass(frozen=True)
class Inputs:
    """What is held during a step: torques or duties of the wheels, the push (force x, y; moment)."""

    drive: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    push: tuple[float, ...] = (0.0, 0.0, 0.0)


class Oracle:
    """The drives torque and voltage, both contacts, without Coulomb friction, and currents below their limit.

    The state: x, y, heading, wheel angles (7); their rates (7); deflections (4); currents (4); charge (1).
    """

    def __init__(self, parameters: Mapping[str, float]) -> None:
        p = {**DEFAULTS, **parameters}
        self.p = p
        self.stands = np.array([1 + 1j, 1 - 1j, -1 - 1j, -1 + 1j])
        self.stands = p["half_length_m"] * self.stands.real + 1j * p["half_width_m"] * self.stands.imag
        self.com = p["com_x_m"] + 1j * p["com_y_m"]
        self.levers = self.stands - self.com
        turned = -1 if p["rollers"] == O else 1
        angle = np.arctan(1 / (1 - p["sideways_loss"]))  # of a roller's axis on the ground, from straight ahead
        self.rollers = np.exp(1j * turned * angle * np.array([-1, 1, -1, 1]))
        self.radius = p["wheel_radius_m"] * np.array([p[name] for name in wheels("radius_factor")])
        self.spin_inertia = p["wheel_inertia_kg_m2"] + p["gear_ratio"] ** 2 * p["rotor_inertia_kg_m2"]
        self.inertia = np.array([p["mass_kg"]] * 2 + [p["inertia_kg_m2"]] + [self.spin_inertia] * 4)
        self.grip = p["grip_coefficient"] * np.array([p[name] for name in GRIPS])
        weight = p["mass_kg"] * G
        self.upright_n = weight * np.cos(p["slope_rad"])
        self.fall_n = -weight * np.sin(p["slope_rad"]) * np.exp(1j * p["slope_direction_rad"])
        # Four equally stiff wheels under a rigid body: their loads lie on a plane, so that the diagonals balance.
        x, y = self.stands.real, self.stands.imag
        self.sharing = np.linalg.inv([np.ones(4), x, y, [1, -1, 1, -1]])
        self.gain = np.array([p[name] for name in wheels("torque_factor")])
        self.axle_constant = p["gear_ratio"] * p["motor_constant_n_m_a"] * self.gain
        self.viscous = p["viscous_n_m_s_rad"] * np.array([p[name] for name in wheels("friction_factor")])

    def start(self) -> np.ndarray:
        """Return the state at the start: the wheels roll, no roller is bent, no current flows."""
        x, y, heading, vx, vy, yaw_rate = (self.p[name] for name in START)
        e = np.exp(1j * heading)
        com = x + 1j * y + e * self.com
        velocity = vx + 1j * vy + 1j * yaw_rate * e * self.com
        contact = velocity + 1j * yaw_rate * e * self.levers
        axis = e * self.rollers
        spin = _dot(axis, contact) / _dot(axis, e) / self.radius
        body = [com.real, com.imag, heading, *np.zeros(4)]
        return np.array([*body, velocity.real, velocity.imag, yaw_rate, *spin, *np.zeros(9)])

    def motion(self, state: np.ndarray) -> np.ndarray:
        """Return pose and twist of the robot's centre, world frame, and the wheel angles, as the plant tells them."""
        e, yaw_rate = np.exp(1j * state[2]), state[9]
        centre = state[0] + 1j * state[1] - e * self.com
        velocity = state[7] + 1j * state[8] - 1j * yaw_rate * e * self.com
        return np.array([centre.real, centre.imag, state[2], velocity.real, velocity.imag, yaw_rate, *state[3:7]])

    def run(self, inputs: list[Inputs], hold_s: float) -> np.ndarray:
        """Return the state after each of ``inputs`` was held for ``hold_s``, from the start."""
        state = self.start()
        for held in inputs:
            done = solve_ivp(
                lambda _, y, held=held: self.rate(y, held), (0, hold_s), state, "DOP853", rtol=1e-12, atol=1e-13
            )
            state = done.y[:, -1]
        return state

    def rate(self, state: np.ndarray, inputs: Inputs) -> np.ndarray:
        """Return the time derivative of the state."""
        p, e = self.p, np.exp(1j * state[2])
        speed, deflection, current, charge = state[7:14], state[14:18], state[18:22], state[22]
        torque, current_rate, charge_rate = self.gain * inputs.drive, np.zeros(4), 0.0
        if p["drive"] == VOLTAGE:
            duty = np.array(inputs.drive)
            charge_rate = duty @ current
            source_v = p["battery_voltage_v"] - p["battery_fall_v_c"] * charge
            battery_v = source_v - p["battery_resistance_ohm"] * charge_rate
            winding_v = duty * battery_v - p["motor_resistance_ohm"] * current - self.axle_constant * speed[3:]
            torque, current_rate = self.axle_constant * current, winding_v / p["motor_inductance_h"]
        else:
            assert p["drive"] == TORQUE
        push = inputs.push[0] + 1j * inputs.push[1]
        on_body = self.fall_n + push
        moment = inputs.push[2] + _cross(-e * self.com, push)
        generalized = np.array([on_body.real, on_body.imag, moment, *(torque - self.viscous * speed[3:])])
        if p["contact"] == SLIP:
            acceleration, deflection_rate = self._slip(e, speed, deflection, generalized)
        else:
            acceleration, deflection_rate = self._rigid(e, speed, generalized), np.zeros(4)
        return np.concatenate([speed, acceleration, deflection_rate, current_rate, [charge_rate]])

    def _rigid(self, e: complex, speed: np.ndarray, generalized: np.ndarray) -> np.ndarray:
        """M a = Q + A^T lambda with A a + (dA/dt) speed = 0: no contact moves along its roller's axis."""
        axis, lever = e * self.rollers, e * self.levers
        constraint = np.zeros((4, 7))
        constraint[:, 0], constraint[:, 1], constraint[:, 2] = axis.real, axis.imag, _dot(axis, 1j * lever)
        constraint[:, 3:] = np.diag(-self.radius * _dot(axis, e))
        # Of A only the axes themselves turn; the other columns are the same in the body frame.
        drift = _dot(1j * speed[2] * axis, speed[0] + 1j * speed[1])
        system = np.block([[np.diag(self.inertia), constraint.T], [constraint, np.zeros((4, 4))]])
        return np.linalg.solve(system, np.concatenate([generalized, -drift]))[:7]

    def _slip(
        self, e: complex, speed: np.ndarray, deflection: np.ndarray, generalized: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Spring and damper along each roller, rolling resistance across it; the load from the balance of moments."""
        p = self.p
        stiffness, r = p["roller_stiffness_n_m"], self.radius
        axis, lever = e * self.rollers, e * self.levers
        contact = speed[0] + 1j * speed[1] + 1j * speed[2] * lever - r * speed[3:] * e
        along, across = _dot(axis, contact), _cross(axis, contact)
        load = np.maximum(0.0, self.load(speed[2], speed[3:], deflection, generalized[3:]))
        limit = self.grip * load / stiffness
        held = np.clip(deflection, -limit, limit)
        bending = self.bending(deflection, along, limit)
        resistance = p["roller_friction_coefficient"] * load * np.tanh(across / 0.01)
        force = axis * (-stiffness * held - p["roller_damping_n_s_m"] * bending) - 1j * axis * resistance
        whole = np.sum(force)
        ground = [whole.real, whole.imag, np.sum(_cross(lever, force)), *(-r * _dot(e, force))]
        return (generalized + ground) / self.inertia, bending - (deflection - held) / 0.005

    def load(self, yaw_rate: float, spin: np.ndarray, deflection: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Loads with which the robot neither pitches nor rolls nor lifts, from the elastic forces; body frame.

        The horizontal part of the angular momentum about the centre of mass is the wheels', whose axles point to the
        left. It changes by the moments of the loads, d x z N = -i d N, and of the forces F at the ground, -i h F.
        """
        elastic = -self.p["roller_stiffness_n_m"] * deflection * self.rollers
        momentum = 1j * self.spin_inertia * np.sum(spin)
        rate = 1j * np.sum(torque - self.radius * elastic.real) + 1j * yaw_rate * momentum
        of_forces = -1j * self.p["com_height_m"] * np.sum(elastic)
        first_moment = 1j * (rate - of_forces) + self.com * self.upright_n
        return self.sharing @ [self.upright_n, first_moment.real, first_moment.imag, 0.0]

    @staticmethod
    def bending(deflection: np.ndarray, along: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """Rate of the deflection after Dupont et al. 2002, equations (4) to (6); without load none bends."""
        part = np.minimum(np.abs(deflection) / np.maximum(limit, 1e-300), 1.0)
        way = np.clip((part - 0.7) / 0.3, 0.0, 1.0)
        plastic = np.where(deflection * along > 0, 0.5 + 0.5 * np.sin(np.pi * (way - 0.5)), 0.0)
        return np.where(limit > 0, along * (1 - plastic * part), 0.0)


def _dot(a: np.ndarray, b: np.ndarray | complex) -> np.ndarray:
    return np.real(np.conj(a) * b)


def _cross(a: np.ndarray | complex, b: np.ndarray | complex) -> np.ndarray:
    return np.imag(np.conj(a) * b)
