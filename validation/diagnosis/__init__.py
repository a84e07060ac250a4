"""What a run that is off does match: variants of the in-repo model, tried one after the other.

``diagnose`` says it in a sentence. ``model`` is the scheme of the codes with faults that it can be given, ``faults``
and ``scaled`` the variants without and with a parameter, ``records`` those that need no other motion, ``fit`` what
finds the parameters, ``failed`` the diagnoses of all runs of a scene that failed.
"""
