"""Constants of the planner that is asked for an accuracy, tuned by measurement.

Each was chosen for the least price of captures with ``scripts/bench accuracy``: the cameras and aims of the
table in docs/strategies.md, in the rooms four-wall, six-wall, open and fence. Where another
measurement counts, its comment says which. Constants of kernels stand beside these: numba's cache does not
notice that they change elsewhere.
"""

# The default: the knee of the curves of docs/chart-accuracy.png.
FEW_CENTERS = 16
"""Optical centres, all of which take about a hundred captures at most: a face cube each."""
DEFAULT_DOUBT_SHARE = 0.03  # of ``auto`` for several optical centres
DEFAULT_MOST_CAPTURES = 100
"""Requests of an image without an accuracy. Furnished rooms need 60 at most; in the courtyard's relief the
aim takes thousands, and from here on twice the price takes a sixth off the doubt."""

# Refinement, of every camera.
ROOM = 0.029  # share of the pixels that faces of 384 px leave in doubt in a furnished room
SAFE = 0.97  # of the pixels that may stay doubtful: what captures are aimed at
LOCAL_MS = 550.0
"""Price by measurement of patches in two modes that leave a quarter of the doubt of a furnished room."""
PATCH_PX = 200_000  # of a typical patch
FINER = (2.0, 3.0, 4.5, 7.0, 11.0)
COARSE_QUANTILE = 0.25  # quantile of the focal lengths of what is in doubt: patches are finer than this
DOUBT_LEFT = 0.85  # of the doubt that n times finer captures leave, by 1 / n
# of the pixels that patches promise, and how many rounds may miss it
LEAST_RESOLVED = 0.15
PATIENCE = 2
MOST_ROUNDS = 12
FINER_FACES = 1.2  # how much more finely faces sample on the mean than patches of their focal length

# Several optical centres: which are captured.
MOST_HIDDEN = 0.4  # of the pixels that may be in doubt: as many rays may stay hidden
LEAST_PROMISED = 0.05  # of the pixels that may be in doubt: rays that a further centre must promise
HIDDEN_LEFT = 0.95  # of the hidden rays: further centres must leave less

INITIAL_VIEWPOINTS = 8  # optical centres that are captured first, if the options give none
SAMPLED_RAYS = 20_000
ON_THE_WAY = (0.0, 0.3, 0.6, 1.0, 2.0, 4.0)  # of the distance from a centre to the ray's origin
NEIGHBOURHOODS = 128
MOST_ERROR_PX = 0.5  # of the image: rays whose lookup may be farther off are unsure

# Several optical centres: depth before masks.
EDGES = 0.9
"""Share of the pixels that may be in doubt, to which depth is refined before masks are captured: label edges
add to its doubt."""
DEPTH_ROUNDS = 4  # of depth alone
ROOM_OF_FEW_CENTERS = 1.7  # doubt of images from few centres, relative to that of one centre
