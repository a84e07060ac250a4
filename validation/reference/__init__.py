"""The in-repo integrators of a Hertz chain: arrays in, arrays out.

The ground floor of the project: nothing here imports anything else of it. Equations of motion, u upwards
(the paper's Eq. 7 for the forces): ``m_j u_j'' = F_j - F_{j+1} + load_j`` with ``F_j = k_j overlap_j^(3/2)``,
or of a contact that loses energy ``F_j = max(0, k_j overlap_j^(3/2) + C_j overlap_j^(1/4) d overlap_j/dt)``.
"""
