"""Pictures and pages from results that are already there; nothing is computed here."""
