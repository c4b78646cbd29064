"""The device's side of pairing: whose key opens its files, and the two minutes in which a new one may come."""
