"""The methods: one module each, named as in the settings (``mvla-gr`` is ``mvla_gr.py``), which exports ``METHOD``."""
