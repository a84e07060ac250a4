"""Contact laws: one module for each law of dissipation, with one class derived from ``drivers.laws.law.ContactLaw``."""

import pkgutil
from importlib import import_module

from drivers.laws.law import ContactLaw


def _laws() -> dict[str, type[ContactLaw]]:
    """Laws of dissipation by the name that ``contact.dissipation`` of a scene gives them."""
    for module in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return {law.name: law for law in sorted(ContactLaw.__subclasses__(), key=lambda law: law.name)}


LAWS = _laws()
