"""The in-repo integrators of a Hertz chain: arrays in, arrays out.

This folder imports no other package of the project. Equations of motion, u positive upwards:
``m_j u_j'' = F_j - F_{j+1} + load_j`` with ``F_j = k_j overlap_j^(3/2)`` (the paper's Eq. 7) for elastic contacts and
``F_j = max(0, k_j overlap_j^(3/2) + C_j overlap_j^(1/4) d overlap_j/dt)`` for dissipative contacts.
"""
