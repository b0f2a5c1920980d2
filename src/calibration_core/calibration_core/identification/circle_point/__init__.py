"""The circle-point method: circles, joint axes and base frame from motions of single joints (CWA 17384, 7.1, 7.2)."""
