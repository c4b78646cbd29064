"""The instrument's screens: heights and live views drawn in terminal cells, and the textual app around them."""
