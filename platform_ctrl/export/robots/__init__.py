"""Robot descriptions (URDF, MJCF, SDF) as plant files."""
