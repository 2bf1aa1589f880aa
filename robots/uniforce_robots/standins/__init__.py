"""Stand-ins for hardware, each a process of its own, so that drivers are tested without any device.

They speak the device's protocol on a pseudo-terminal or on loopback, show what the project's contact simulator gives
for a touch, and break on command.  They prove protocol and software, not dynamics, optics or a real bus.
"""
