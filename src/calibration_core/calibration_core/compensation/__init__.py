"""Using a calibrated robot: how it deflects, and where to send it so that its tool arrives."""
