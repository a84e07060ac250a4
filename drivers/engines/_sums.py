"""Contact forces from the total forces on bodies: what the codes hand out cheaply and exactly."""

import numpy as np

from drivers.chain.chain import Array


def contact_forces(lowest_N: Array, contacts_N: Array) -> Array:
    """Forces along the axis, contact by contact from the lowest up: ``F_{j+1} = F_j - f_j``.

    Args:
        lowest_N: of contact 1, zero where there is no wall. Shape (samples,).
        contacts_N: on each body by its two contacts, upwards positive. Shape (samples, bodies).

    Returns:
        Shape (samples, bodies).
    """
    force = np.empty_like(contacts_N)
    force[:, 0] = lowest_N
    for j in range(contacts_N.shape[1] - 1):
        force[:, j + 1] = force[:, j] - contacts_N[:, j]
    return force


def towards_axis(place_m: Array, bore_N: Array) -> Array:
    """The bore's force on each body, towards the axis.

    Args:
        place_m: off the axis, shape (samples, bodies, 2).
        bore_N: across the axis, likewise.

    Returns:
        Shape (samples, bodies).
    """
    distance = np.maximum(np.hypot(place_m[:, :, 0], place_m[:, :, 1]), 1e-300)
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that blew up, which the guard says in words
        return np.asarray(-(place_m * bore_N).sum(axis=2) / distance)
