"""CARFF: belief, forecast and plan over 3-D scenes."""
