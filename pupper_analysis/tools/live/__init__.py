"""Open a page to play with stances.

A server with a page per browser: sliders for a stance, a 3-D scene, and the loads of the stance.
"""

HELP_HEADING = "Look"
"""Section of ``--help`` that lists this tool."""
