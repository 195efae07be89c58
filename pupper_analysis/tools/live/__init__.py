"""Open a page to play with stances.

A page to play with: sliders in, a stand and what it takes out.
"""

HEADING = "Look"
