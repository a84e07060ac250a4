"""Definitions of the observables, printed by ``beads observables --definitions``."""

SYMBOLS = """\
f is the signal of a gauge, s(t) = f(t) - f(0), t_p the time of its first pulse, d the diameter of the bead, z its
height at time 0, E the total energy, p the momentum. N is the sum of the external forces: weight, precompression, wall,
friction of the tube. P is the largest of |p(t)| and the sum of |m v| at time 0; where nothing moves, also the load
times the duration.

A maximum is a sample of s above its two neighbours, not the first or the last sample; of equal samples between lower
ones it is the middle one, of an even number the earlier. Its height and time are those of the highest point, within one
sample, of a quintic polynomial through the samples around. Its prominence is its sample less the higher of two minima:
on each side the smallest sample as far as the next one that is larger than the maximum, or to the end of the record.
The range is the largest less the smallest sample.

A pulse is a maximum whose prominence is at least 1e-4 of the range and at least 0.01 of its own height, and whose
height is above 0 and above 0.05 of that of every pulse before it. If the range is at most 1e-9 of the largest force of
all contacts, there is no pulse. The first pulse is the incident wave.

A pulse at bead j goes up if the contacts push the bead upwards while it rises. With the changes d_j = F_j - F_j(0) and
d_(j+1) of the contact forces below and above the bead, without electronics, it rises from the sample with the smallest
d_j + d_(j+1) (the earliest of equal ones) since the maximum of the pulse before, or since time 0, to the sample of its
own maximum. It goes up if the sum of d_j - d_(j+1) over these samples, both ends included, is above 1e-6 of the sum of
|d_j| + |d_(j+1)|. At the top bead of a chain without a striker the contacts of the bead below are taken. At bead 1
above a wall, where a wave and its reflection coincide, no pulse goes up."""
DEFINITIONS = {
    "{gauge}_static_N": "f(0)",
    "{gauge}_amplitude_N": "A = s(t_p)",
    "{gauge}_peak_N": "A + f(0)",
    "{gauge}_arrival_s": "t_p",
    "{gauge}_duration_{level}_s": "2 (t_p - t_l); before t_p, s last rises through the level times A at t_l",
    "{gauge}_width_{level}_diameters": "duration times speed from the sensor above, divided by d",
    "{gauge}_front_arrival_s": "time at which s last rises through 0.02 A, before t_p",
    "{gauge}_pulses": "number of pulses at a sensor bead that do not go up, before the reflected one",
    "{gauge}_second_amplitude_N": "s at the second of these pulses",
    "{gauge}_second_arrival_s": "time of the second of these pulses",
    "{gauge}_valley_N": "smallest sample of s between the first of these pulses and the second",
    "{gauge}_reflected_amplitude_N": "s at the first pulse that goes up and is later than the wall's first pulse",
    "{gauge}_reflected_arrival_s": "time of that pulse",
    "wall_peak_{number}_N": "force at the wall's next maxima (2, 3) with a prominence of at least 0.01 of the range",
    "wall_envelope_per_s": "rate r of C exp(r t) through the wall's first three maxima, least squares of the logarithm",
    "speed_{pair}_m_s": "(z_i - z_j) / (t_p,j - t_p,i) between neighbouring sensors i above j",
    "transmission_{pair}": "(A_j / A_i)^(1 / (i - j)) of neighbouring sensors: share passed on from bead to bead",
    "contact_loss_s": "first sample with an open contact that carries more than 1e-9 of the largest force at time 0",
    "kinetic_energy_start_J": "kinetic energy at time 0",
    "energy_drift_J": "largest |E - E(0)|; with damping the largest gain over an earlier E, with friction over E(0)",
    "energy_lost_J": "E(0) - E(end), with damping or friction",
    "energy_error_before_wall_J": "energy drift until the force on the wall changes",
    "momentum_start_N_s": "p(0)",
    "momentum_end_N_s": "p at the end",
    "momentum_error_before_wall_share": "largest |p - p(0) - N(0) t| / P until the force on the wall changes",
    "impulse_imbalance_share": "largest |p - p(0) - I| / P, with I the integral of N from time 0",
    "impulse_sampling_share": "largest change of I / P if every other sample is left out",
}
