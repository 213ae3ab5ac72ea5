"""Models that learn by gradient steps: networks, their training, and the light they are trained on.

What they start from is fitted in closed form by `prt_bench/methods`; what they ship is an asset like any other.
"""
