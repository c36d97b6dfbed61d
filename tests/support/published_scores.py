"""Twenty images, and what the evaluation code of four papers says of them."""

import numpy as np


def images():
    """Yield predictions (H, W) metres, truths, and pixels that count, of 20 images by formulas."""
    v, u = np.mgrid[:80, :130] / np.array([80.0, 130.0])[:, None, None]
    for number in range(20):
        t = 2 + number / 10 + 1.5 * np.sin(5 * u + number) * np.cos(4 * v) + 3 * (u > 0.6) * (v > 0.3)
        error = 0.1 * np.sin(9 * u - number) + 0.15 * np.cos(13 * v + 2 * number) + 0.08 * np.sin(71 * u * v)
        p = 0.8 * t * np.exp(error) + 0.1
        yield p, t, np.sin(37 * u + 11 * v + number) < 0.93


FIGURES = {
    "depth-anywhere": {
        "a1": 0.8961121018063631,
        "a2": 1.0,
        "a3": 1.0,
        "abs": 0.41833152017692826,
        "abs_rel": 0.10996188935677602,
        "log10": 0.04825453619512802,
        "rmse": 0.5618740283088929,
        "rmse_log": 0.04543831120745209,
        "sq_rel": 0.06938270692043855,
    },
    "depth-any-camera": {
        "abs_rel": 0.16482369744107248,
        "d05": 0.32624310915486354,
        "d1": 0.6286241348544441,
        "d2": 0.9823048649077616,
        "d3": 1.0,
        "log10": 0.08102831542993094,
        "rmse": 0.8113577088633945,
        "rmse_log": 0.22092063490436514,
        "scale": 1.2025555999249848,
        "silog": 13.385940539416055,
        "sq_rel": 0.1451114349561921,
    },
    "unik3d": {
        "arel": 0.1648236974410725,
        "arel_si": 0.11223990624581914,
        "arel_ssi": 0.10833134348485181,
        "d1": 0.6286241348544446,
        "d1_si": 0.8935914618212186,
        "d1_ssi": 0.9075519503784587,
        "d2": 0.9823048649077617,
        "d3": 1.0,
        "d_auc": 0.8327396656738084,
        "log10": 0.08102831542993093,
        "medianlog": 17.52517131494809,
        "rmse": 0.8113570764719025,
        "rmselog": 0.22091835899036458,
        "silog": 13.385940539416055,
        "sqrel": 0.1451114349561921,
        "tau": 0.08367066424064853,
        "tau_si": 0.1552346936579922,
        "tau_ssi": 0.16663404340713334,
    },
    "moge": {
        "delta1_affine": 0.9080805063929395,
        "delta1_disparity": 0.9099185095476543,
        "delta1_metric": 0.6286241348544446,
        "delta1_scale": 0.8988830632277851,
        "rel_affine": 0.10544047355122961,
        "rel_disparity": 0.10607909853551009,
        "rel_metric": 0.16482364431910534,
        "rel_scale": 0.10960564916774156,
    },
}
"""Means over the images by the authors' own evaluation code, whose arrays were float64.

Of ``depth-anywhere`` the predictions were ``0.7 / p + 0.05``."""
