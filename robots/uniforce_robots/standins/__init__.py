"""Stand-ins for hardware, each a process of its own, so that drivers are tested without any device.

They speak the device's protocol on a pseudo-terminal or on loopback, show touches of the project's
contact simulator, and break on command. They test protocol and software, not dynamics, optics or a
real bus.
"""
