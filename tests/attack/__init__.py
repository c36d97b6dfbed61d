"""Attacks from outside, drawn from seeds: hostile texts, servers, recordings, folders, and signals.

A family is a function ``case(rng, folder)``: it draws one attack, carries it out within an empty folder, and
raises where anything but a clear refusal or the right result comes out. ``tests/attack/test_attack.py`` runs
some of each; ``scripts/attack --minutes 30`` as many as it can.
"""
