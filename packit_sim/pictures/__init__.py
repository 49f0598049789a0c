"""What people look at: PyBullet's camera, contact sheets, the viewer's page, plots."""
