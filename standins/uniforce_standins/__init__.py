"""Devices that are not there: processes that speak a device's own protocol, for tests and dry runs."""
