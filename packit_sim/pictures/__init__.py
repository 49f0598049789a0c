"""What people look at: PyBullet's camera, contact sheets, films, exports, plots."""
