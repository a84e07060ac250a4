"""When a run first leaves the exact motion, and why: a fault shows at once, truncation with the wave, chaos after it.

``departure`` says it in a sentence, ``expected`` is what a run is held against, ``first_fault`` finds where it is not
what its scheme makes of the scene.
"""
