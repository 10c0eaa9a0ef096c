"""What a calibration is worth: how much the data said, how well it predicts, what is odd."""
