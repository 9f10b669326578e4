"""Triangle meshes: reading, soundness, repair and nearest triangles."""
