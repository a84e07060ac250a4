"""Laws of dissipation: one module for each, with one class derived from ``drivers.laws.law.Dissipation``."""

import pkgutil
from importlib import import_module

from drivers.laws.law import Dissipation


def _laws() -> dict[str, type[Dissipation]]:
    """Laws of dissipation by the name that ``contact.dissipation`` of a scene gives them."""
    for module in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    laws = [law for law in Dissipation.__subclasses__() if law.damped]
    return {law.name: law for law in sorted(laws, key=lambda law: law.name)}


LAWS = _laws()
