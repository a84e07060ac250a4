"""One step of DOP853 (Dormand and Prince, order 8) for a Hertz chain, in stretched time.

An elastic force is proportional to overlap^(3/2). Around a time t_e at which a contact opens or closes, the motion is
smooth in ``s = |t - t_e|^(1/2)`` but not in t. The force of a dissipative contact that closes starts with
(t - t_e)^(1/4), and the motion is smooth in ``s = (t - t_e)^(1/4)``. Steps are therefore taken in s: with
``t = t_e + s^power`` the equations are ``dy/ds = power s^(power - 1) f(y)``, and the method keeps its order through
the event. Powers -2 and -4 mean ``t = t_e - s^2`` and ``t = t_e - s^4``.

The kernels share two tables, so that calls pass few arrays, whose reference counts would take a third of a small
chain's time. ``rows`` holds states, a row each: overlaps, velocities, and integrals of ``hertz_chain.motion_with``, on
which no step size depends. ``bodies`` holds numbers of each body and of the contact under it, and the force of the
contact above the highest body.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from validation.reference.contact_kernels import damped_force, elastic_force, power_force, root_raised, segment_value
from validation.reference.hertz_chain import COLUMNS, VISCOELASTIC_POWER, Array

STAGES = 12
# coefficients of DOP853 by Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd edition, 1993
# fmt: off
# times of the stages, as shares of the step
C = np.array([0.0, 0.526001519587677318785587544488e-1, 0.789002279381515978178381316732e-1,
    0.118350341907227396726757197510, 0.281649658092772603273242802490, 0.333333333333333333333333333333, 0.25,
    0.307692307692307692307692307692, 0.651282051282051282051282051282, 0.6, 0.857142857142857142857142857142,
    1.0, 1.0, 0.1, 0.2, 0.777777777777777777777777777778])
# a_ij of each stage, of the end of the step and of the stages for dense output: weights by column
A: dict[int, dict[int, float]] = {
    1: {0: 5.26001519587677318785587544488e-2},
    2: {0: 1.97250569845378994544595329183e-2, 1: 5.91751709536136983633785987549e-2},
    3: {0: 2.95875854768068491816892993775e-2, 2: 8.87627564304205475450678981324e-2},
    4: {0: 2.41365134159266685502369798665e-1, 2: -8.84549479328286085344864962717e-1,
        3: 9.24834003261792003115737966543e-1},
    5: {0: 3.7037037037037037037037037037e-2, 3: 1.70828608729473871279604482173e-1,
        4: 1.25467687566822425016691814123e-1},
    6: {0: 3.7109375e-2, 3: 1.70252211019544039314978060272e-1, 4: 6.02165389804559606850219397283e-2,
        5: -1.7578125e-2},
    7: {0: 3.70920001185047927108779319836e-2, 3: 1.70383925712239993810214054705e-1,
        4: 1.07262030446373284651809199168e-1, 5: -1.53194377486244017527936158236e-2,
        6: 8.27378916381402288758473766002e-3},
    8: {0: 6.24110958716075717114429577812e-1, 3: -3.36089262944694129406857109825,
        4: -8.68219346841726006818189891453e-1, 5: 2.75920996994467083049415600797e1,
        6: 2.01540675504778934086186788979e1, 7: -4.34898841810699588477366255144e1},
    9: {0: 4.77662536438264365890433908527e-1, 3: -2.48811461997166764192642586468,
        4: -5.90290826836842996371446475743e-1, 5: 2.12300514481811942347288949897e1,
        6: 1.52792336328824235832596922938e1, 7: -3.32882109689848629194453265587e1,
        8: -2.03312017085086261358222928593e-2},
    10: {0: -9.3714243008598732571704021658e-1, 3: 5.18637242884406370830023853209,
        4: 1.09143734899672957818500254654, 5: -8.14978701074692612513997267357,
        6: -1.85200656599969598641566180701e1, 7: 2.27394870993505042818970056734e1,
        8: 2.49360555267965238987089396762, 9: -3.0467644718982195003823669022},
    11: {0: 2.27331014751653820792359768449, 3: -1.05344954667372501984066689879e1,
        4: -2.00087205822486249909675718444, 5: -1.79589318631187989172765950534e1,
        6: 2.79488845294199600508499808837e1, 7: -2.85899827713502369474065508674,
        8: -8.87285693353062954433549289258, 9: 1.23605671757943030647266201528e1,
        10: 6.43392746015763530355970484046e-1},
    12: {0: 5.42937341165687622380535766363e-2, 5: 4.45031289275240888144113950566,
        6: 1.89151789931450038304281599044, 7: -5.8012039600105847814672114227, 8: 3.1116436695781989440891606237e-1,
        9: -1.52160949662516078556178806805e-1, 10: 2.01365400804030348374776537501e-1,
        11: 4.47106157277725905176885569043e-2},
    13: {0: 5.61675022830479523392909219681e-2, 6: 2.53500210216624811088794765333e-1,
        7: -2.46239037470802489917441475441e-1, 8: -1.24191423263816360469010140626e-1,
        9: 1.5329179827876569731206322685e-1, 10: 8.20105229563468988491666602057e-3,
        11: 7.56789766054569976138603589584e-3, 12: -8.298e-3},
    14: {0: 3.18346481635021405060768473261e-2, 5: 2.83009096723667755288322961402e-2,
        6: 5.35419883074385676223797384372e-2, 7: -5.49237485713909884646569340306e-2,
        10: -1.08347328697249322858509316994e-4, 11: 3.82571090835658412954920192323e-4,
        12: -3.40465008687404560802977114492e-4, 13: 1.41312443674632500278074618366e-1},
    15: {0: -4.28896301583791923408573538692e-1, 5: -4.69762141536116384314449447206,
        6: 7.68342119606259904184240953878, 7: 4.06898981839711007970213554331,
        8: 3.56727187455281109270669543021e-1, 12: -1.39902416515901462129418009734e-3,
        13: 2.9475147891527723389556272149, 14: -9.15095847217987001081870187138},
}
# error estimates of order 5 and 3, by stage
E5: dict[int, float] = {0: 0.1312004499419488073250102996e-1, 5: -0.1225156446376204440720569753e1,
    6: -0.4957589496572501915214079952, 7: 0.1664377182454986536961530415e1, 8: -0.3503288487499736816886487290,
    9: 0.3341791187130174790297318841, 10: 0.8192320648511571246570742613e-1,
    11: -0.2235530786388629525884427845e-1}
# E3 is subtracted from the weights of the end
E3 = {0: 0.244094488188976377952755905512, 8: 0.733846688281611857341361741547, 11: 0.220588235294117647058823529412e-1}
# rows 4 to 7 of the dense output
D: dict[int, dict[int, float]] = {
    0: {0: -0.84289382761090128651353491142e1, 5: 0.56671495351937776962531783590,
        6: -0.30689499459498916912797304727e1, 7: 0.23846676565120698287728149680e1,
        8: 0.21170345824450282767155149946e1, 9: -0.87139158377797299206789907490,
        10: 0.22404374302607882758541771650e1, 11: 0.63157877876946881815570249290,
        12: -0.88990336451333310820698117400e-1, 13: 0.18148505520854727256656404962e2,
        14: -0.91946323924783554000451984436e1, 15: -0.44360363875948939664310572000e1},
    1: {0: 0.10427508642579134603413151009e2, 5: 0.24228349177525818288430175319e3,
        6: 0.16520045171727028198505394887e3, 7: -0.37454675472269020279518312152e3,
        8: -0.22113666853125306036270938578e2, 9: 0.77334326684722638389603898808e1,
        10: -0.30674084731089398182061213626e2, 11: -0.93321305264302278729567221706e1,
        12: 0.15697238121770843886131091075e2, 13: -0.31139403219565177677282850411e2,
        14: -0.93529243588444783865713862664e1, 15: 0.35816841486394083752465898540e2},
    2: {0: 0.19985053242002433820987653617e2, 5: -0.38703730874935176555105901742e3,
        6: -0.18917813819516756882830838328e3, 7: 0.52780815920542364900561016686e3,
        8: -0.11573902539959630126141871134e2, 9: 0.68812326946963000169666922661e1,
        10: -0.10006050966910838403183860980e1, 11: 0.77771377980534432092869265740,
        12: -0.27782057523535084065932004339e1, 13: -0.60196695231264120758267380846e2,
        14: 0.84320405506677161018159903784e2, 15: 0.11992291136182789328035130030e2},
    3: {0: -0.25693933462703749003312586129e2, 5: -0.15418974869023643374053993627e3,
        6: -0.23152937917604549567536039109e3, 7: 0.35763911791061412378285349910e3,
        8: 0.93405324183624310003907691704e2, 9: -0.37458323136451633156875139351e2,
        10: 0.10409964950896230045147246184e3, 11: 0.29840293426660503123344363579e2,
        12: -0.43533456590011143754432175058e2, 13: 0.96324553959188282948394950600e2,
        14: -0.39177261675615439165231486172e2, 15: -0.14972683625798562581422125276e3},
}
# fmt: on
# rows of FORMULAS: each stage, the end of the step, stages of dense output, two error estimates, dense output
SLOPES, END = 16, STAGES
FIFTH, THIRD, DENSE = SLOPES, SLOPES + 1, SLOPES + 2
FORMULAS = np.zeros((DENSE + 4, SLOPES))
for _formula, _weights in {**A, FIFTH: E5, **{DENSE + row: weights for row, weights in D.items()}}.items():
    FORMULAS[_formula, list(_weights)] = list(_weights.values())
FORMULAS[THIRD] = FORMULAS[END]
FORMULAS[THIRD, list(E3)] -= list(E3.values())
# per formula: slopes with weights other than 0 (other slopes may not be finite), their weights, their number
TERMS = np.argsort(FORMULAS == 0, axis=1, kind="stable")
WEIGHTS = np.take_along_axis(FORMULAS, TERMS, axis=1)
TERMS[WEIGHTS == 0] = 0
COUNTS = np.count_nonzero(FORMULAS, axis=1)
ROUNDING = 0.5**53  # relative rounding error of a double
# rows of the table of states: the slopes dy/ds; at the start of a step values, their rounding errors (Kahan) and their
# slopes dy/dt; the same three at its end; the same of an intermediate result; polynomial of the step; zeros
START = SLOPES
STOP, SPARE, POLYNOMIAL = START + 3, START + 6, START + 9
ZEROS = POLYNOMIAL + 7
STATES = ZEROS + 1
ERRORS, RATES = 1, 2  # after the row of the values
# rows of the table of bodies; GRIPS: 1 if the contact may exert a force in the present step, 0 if not, -1 if its
# overlap decides (only with the power law); STATIC: elastic force at time 0
STIFFNESS, DAMPING, INVERSE_MASS, ACCELERATION, FORCE, GRIPS, STATIC = range(7)
ELASTIC, DAMPED, POWER_LAW = range(3)
LAST, NEXT = COLUMNS, COLUMNS + 1  # of a drive's array, after its segment: times of events since the segment begins


class KernelLaw(NamedTuple):
    """Numbers that hold for all bodies.

    Attributes:
        law: ``ELASTIC``, ``DAMPED`` or ``POWER_LAW``.
        exponent: of the overlap in damping, or alpha of the power law.
        driven: True if there is a drive.
        body: driven body.
        prescribed: True if it moves as prescribed, with an inverse mass of 0.
        constant: its acceleration by its constant load.
        load: this load.
        below: velocity of what is below the lowest body.
    """

    law: int
    exponent: float
    driven: bool
    body: int
    prescribed: bool
    constant: float
    load: float
    below: float


@njit(error_model="numpy", forceinline=True)
def closing_speed(rows: Array, row: int, n: int, contact: int, below: float) -> float:
    """Closing speed ``d'`` of a contact from values or, with 0 as velocity ``below`` the lowest body, from slopes."""
    return float((rows[row, n + contact - 1] if contact > 0 else below) - rows[row, n + contact])


@njit(error_model="numpy", forceinline=True)
def slope(rows: Array, row: int, result: int, n: int, size: int, stretch: float, bodies: Array, law: KernelLaw) -> None:
    """Writes ``stretch * dy/dt`` of the values in a row to another row; most loops compile to vector instructions."""
    at_once = stretch if law.law == ELASTIC else 1.0
    rows[result, 0] = at_once * (law.below - rows[row, n])
    for j in range(1, n):
        rows[result, j] = at_once * (rows[row, n + j - 1] - rows[row, n + j])
    if law.law == ELASTIC:
        for j in range(n):
            bodies[FORCE, j] = elastic_force(bodies[STIFFNESS, j], max(rows[row, j], 0.0))
    elif law.law == DAMPED and law.exponent == VISCOELASTIC_POWER:
        for j in range(n):
            stiffness, damping, overlap = bodies[STIFFNESS, j], bodies[DAMPING, j], max(rows[row, j], 0.0)
            bodies[FORCE, j] = damped_force(stiffness, damping, VISCOELASTIC_POWER, overlap, rows[result, j])
    elif law.law == DAMPED:
        for j in range(n):  # a loop of its own, so that the other one compiles to vector instructions
            bodies[FORCE, j] = root_raised(sqrt(max(rows[row, j], 0.0)), law.exponent)
        for j in range(n):
            elastic = elastic_force(bodies[STIFFNESS, j], max(rows[row, j], 0.0))
            bodies[FORCE, j] = max(elastic + bodies[DAMPING, j] * bodies[FORCE, j] * rows[result, j], 0.0)
    else:
        for j in range(n):
            bodies[FORCE, j] = 0.0
            if bodies[GRIPS, j] > 0.0 or bodies[GRIPS, j] < 0.0 <= rows[row, j]:
                overlap, closing = max(rows[row, j], 0.0), rows[result, j]
                force = power_force(bodies[STIFFNESS, j], bodies[DAMPING, j], law.exponent, overlap, closing)
                bodies[FORCE, j] = force
    for j in range(n):
        net = (bodies[FORCE, j] - bodies[FORCE, j + 1]) * bodies[INVERSE_MASS, j]
        rows[result, n + j] = stretch * (net + bodies[ACCELERATION, j])
    if law.law != ELASTIC:
        for j in range(n):
            rows[result, j] *= stretch
    if size > 2 * n:
        _powers(rows, row, result, n, size, stretch, bodies, law)


@njit(error_model="numpy")
def _powers(
    rows: Array, row: int, result: int, n: int, size: int, stretch: float, bodies: Array, law: KernelLaw
) -> None:
    """Writes ``stretch`` times the integrands of ``hertz_chain.motion_with``, with the forces of all contacts.

    For a contact it is ``(F - F(0)) d'``, which stays smooth when the overlap of a released contact reaches 0.
    """
    first = 2 * n
    rows[result, first], rows[result, first + 1] = 0.0, 0.0
    if law.driven:
        by_drive = bodies[FORCE, law.body + 1] - bodies[FORCE, law.body] - law.load
        if not law.prescribed:
            by_drive = (bodies[ACCELERATION, law.body] - law.constant) / bodies[INVERSE_MASS, law.body]
        rows[result, first] = stretch * by_drive * rows[row, n + law.body]
        rows[result, first + 1] = stretch * by_drive
    if size > first + 2:
        for j in range(n):
            further = stretch * (bodies[FORCE, j] - bodies[STATIC, j])
            rows[result, first + 2 + j] = further * closing_speed(rows, row, n, j, law.below)
            rows[result, first + 2 + n + j] = -further * rows[row, n + j]


@njit(error_model="numpy", forceinline=True)
def stretch_at(s: float, power: float) -> float:
    """``dt/ds``."""
    return power * s * s * s if abs(power) == 4.0 else power * s


@njit(error_model="numpy", forceinline=True)
def drive_until(elapsed: float, bodies: Array, drive: Array, law: KernelLaw) -> None:
    """Sets the acceleration of the driven body without contact forces, at a time since the last event."""
    if law.driven:
        value, _, bend = segment_value(drive, drive[LAST] + elapsed)
        by_force = law.constant + value * bodies[INVERSE_MASS, law.body]
        bodies[ACCELERATION, law.body] = bend if law.prescribed else by_force


@njit(error_model="numpy", forceinline=True)
def _drive_at(s: float, power: float, bodies: Array, drive: Array, law: KernelLaw) -> None:
    """``drive_until`` at a place s; with a negative power, s counts back from the next event."""
    if law.driven:
        raised = s * s * s * s if abs(power) == 4.0 else s * s
        drive_until(raised if power > 0.0 else drive[NEXT] - raised, bodies, drive, law)


@njit(error_model="numpy", forceinline=True)
def weigh(rows: Array, size: int, formula: int | np.int64, h: float, start: int | np.int64, result: int) -> None:
    """Writes row ``start`` plus ``h * FORMULAS[formula] @ slopes`` to row ``result``, four slopes at a time."""
    row, weight = TERMS[formula], WEIGHTS[formula]
    for k in range(0, COUNTS[formula], 4):
        a, b, c, d = h * weight[k], h * weight[k + 1], h * weight[k + 2], h * weight[k + 3]
        one, two, three, four = row[k], row[k + 1], row[k + 2], row[k + 3]
        if k == 0:
            for i in range(size):
                more = a * rows[one, i] + b * rows[two, i] + c * rows[three, i] + d * rows[four, i]
                rows[result, i] = rows[start, i] + more
        else:  # a loop of its own: one with two rows that may be the same does not compile to vector instructions
            for i in range(size):
                rows[result, i] += a * rows[one, i] + b * rows[two, i] + c * rows[three, i] + d * rows[four, i]


@njit(error_model="numpy")
def step(
    rows: Array,
    n: int,
    size: int,
    s: float,
    h: float,
    power: float,
    stop: int,
    bodies: Array,
    drive: Array,
    law: KernelLaw,
) -> None:
    """Takes a step from s to s + h; fills the slopes, and from row ``stop`` on the values and their rounding errors."""
    stretch = stretch_at(s, power)
    for i in range(size):
        rows[0, i] = stretch * rows[START + RATES, i]
    for stage in range(1, STAGES):
        weigh(rows, size, stage, h, START, stop)
        _drive_at(s + C[stage] * h, power, bodies, drive, law)
        slope(rows, stop, stage, n, size, stretch_at(s + C[stage] * h, power), bodies, law)
    weigh(rows, size, END, h, START + ERRORS, stop + ERRORS)
    for i in range(size):
        start, change = rows[START, i], rows[stop + ERRORS, i]
        result = start + change
        kept = result - start
        rows[stop, i] = result
        rows[stop + ERRORS, i] = (start - (result - kept)) + (change - kept)


@njit(error_model="numpy")
def error(
    rows: Array, n: int, size: int, s_end: float, h: float, power: float, scales: tuple[float, float],
    tolerance: float, bodies: Array, drive: Array, law: KernelLaw,
) -> float:  # fmt: skip
    """Largest local error divided by ``tolerance * scales``, by the two embedded formulas; fills the slope at the end.

    The allowed error of a velocity is at least the effect of rounding errors of the body's forces in the step. It
    exceeds the tolerance for light bodies between large, nearly equal forces; shorter steps would not lower it.
    """
    _drive_at(s_end, power, bodies, drive, law)
    slope(rows, STOP, STOP + RATES, n, size, 1.0, bodies, law)
    stretch, largest = stretch_at(s_end, power), 0.0
    rounding = ROUNDING * abs(h * stretch) / tolerance
    for i in range(size):
        rows[STAGES, i] = stretch * rows[STOP + RATES, i]
    weigh(rows, 2 * n, FIFTH, h, ZEROS, SPARE)
    for i in range(2 * n):
        fifth, scale = rows[SPARE, i], scales[0] if i < n else scales[1]
        if abs(fifth) <= largest * scale:  # the estimate is smaller still
            continue
        third, j = 0.0, i - n
        for k in range(COUNTS[THIRD]):
            third += h * WEIGHTS[THIRD, k] * rows[TERMS[THIRD, k], i]
        ratio = third / fifth  # a ratio, since squares of tiny values ahead of a wave underflow
        if j >= 0:
            force = elastic_force(bodies[STIFFNESS, j], max(rows[STOP, j], 0.0))
            above = elastic_force(bodies[STIFFNESS, j + 1], max(rows[STOP, j + 1], 0.0)) if j + 1 < n else 0.0
            scale = max(scale, rounding * (force + above) * bodies[INVERSE_MASS, j])
        estimate = abs(fifth) / sqrt(1.0 + 0.01 * ratio * ratio) / scale
        if not estimate <= largest:  # a NaN counts as largest
            largest = estimate
    return largest / tolerance


@njit(error_model="numpy")
def step_factor(error: float, most: float) -> float:
    """Ratio of the next step to this step, at most ``most``, from its error divided by the tolerance.

    It is below 1 if the step must be repeated. Without a margin for contacts that open and close, and with growth in
    the step after a repeated one, a third of all steps would be repeated.
    """
    if not error < 1e300:
        return 0.2
    return float(min(most, max(0.2 if error > 1.0 else 0.333, 0.8 * error**-0.125))) if error > 0.0 else most


@njit(error_model="numpy")
def prepare_dense(
    rows: Array, n: int, size: int, s: float, h: float, power: float, bodies: Array, drive: Array, law: KernelLaw
) -> None:
    """Fills the polynomial of the step that ``step`` took, with the slope at its end."""
    for stage in range(STAGES + 1, SLOPES):
        weigh(rows, size, stage, h, START, SPARE)
        _drive_at(s + C[stage] * h, power, bodies, drive, law)
        slope(rows, SPARE, stage, n, size, stretch_at(s + C[stage] * h, power), bodies, law)
    for i in range(size):
        change = rows[STOP, i] - rows[START, i]
        rows[POLYNOMIAL, i] = change
        rows[POLYNOMIAL + 1, i] = h * rows[0, i] - change
        rows[POLYNOMIAL + 2, i] = 2.0 * change - h * (rows[STAGES, i] + rows[0, i])
    for row in range(4):
        weigh(rows, size, DENSE + row, h, ZEROS, POLYNOMIAL + 3 + row)


@njit(error_model="numpy")
def evaluate_dense(rows: Array, size: int, x: float) -> None:
    """Writes the state at the fraction x of the step to row ``SPARE``; the interpolant has order 7."""
    for i in range(size):
        value = rows[POLYNOMIAL + 6, i] * x
        value = (value + rows[POLYNOMIAL + 5, i]) * (1.0 - x)
        value = (value + rows[POLYNOMIAL + 4, i]) * x
        value = (value + rows[POLYNOMIAL + 3, i]) * (1.0 - x)
        value = (value + rows[POLYNOMIAL + 2, i]) * x
        value = (value + rows[POLYNOMIAL + 1, i]) * (1.0 - x)
        rows[SPARE, i] = rows[START, i] + (value + rows[POLYNOMIAL, i]) * x
