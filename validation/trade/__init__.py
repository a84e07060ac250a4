"""What accuracy costs: errors against time for every engine and step, the levers users pull, and what to use.

``ladder`` says what is run, ``measure`` runs it, ``levers`` measures what else users do, ``advice`` reads it all,
``diagrams`` draws it, ``section`` tells the report.
"""
