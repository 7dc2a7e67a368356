"""Pictures and pages from results that are already there; nothing is computed here.

What a function is given to draw into it returns: ``ax`` or ``axes``, or, for several panels, ``figure``: an empty
figure or part of one. Without any it returns a new figure.
"""
