"""A stand-in for a Franka Research 3 with its hand, on the wire: FCI version 10 and Hand version 3.

It tests protocol and software, not the dynamics or the timing of a real arm. Start it with ``python
-m uniforce_robots.standins.fci 127.0.0.2``; the real client, franky, connects to that address.
"""
