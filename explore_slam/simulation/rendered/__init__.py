"""The rendered simulator: MuJoCo scene, camera, laser, differential drive."""
