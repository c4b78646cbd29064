"""The library of pulled bundles."""
