"""The rendered simulator: MuJoCo model, camera, laser, differential drive."""
