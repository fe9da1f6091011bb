"""The discrete algebraic Riccati equation, solved by doubling. Needs NumPy, and is for construction only."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_DOUBLINGS = 60


def lqr_gain(
    a: "NDArray[np.float64]", b: "NDArray[np.float64]", q: "NDArray[np.float64]", r: "NDArray[np.float64]"
) -> "NDArray[np.float64]":
    """Return K of u = -K x, which minimises the sum of xᵀ Q x + uᵀ R u over all ticks of x⁺ = A x + B u.

    ``a`` is n by n, ``b`` n by m, ``q`` n by n, ``r`` m by m and invertible; K is m by n. The Riccati equation is
    solved by structured doubling, which squares the closed loop at every step (E. K.-W. Chu et al., "A structure
    preserving doubling algorithm for periodic discrete-time algebraic Riccati equations", Int. J. Control 77,
    2004). Raises ValueError where it does not converge: the pair (A, B) cannot be stabilised.
    """
    import numpy as np

    identity = np.eye(len(a))
    # Of k ticks: A the transition, G what the inputs reach, and H the cost, which tends to the solution.
    transition, reached, cost = a, b @ np.linalg.solve(r, b.T), q
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_DOUBLINGS):
            shared = np.linalg.inv(identity + reached @ cost)
            step = transition.T @ cost @ shared @ transition
            transition, reached, cost = (
                transition @ shared @ transition,
                reached + transition @ shared @ reached @ transition.T,
                cost + step,
            )
            if not np.isfinite(cost).all():
                break
            if np.abs(step).max() <= 1e-14 * np.abs(cost).max():
                return np.asarray(np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a), dtype=np.float64)
    raise ValueError("the Riccati equation has no stabilising solution for these weights")
