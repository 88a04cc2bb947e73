"""MJCF, the model files of MuJoCo: a platform out of it and into it."""
