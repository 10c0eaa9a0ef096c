"""Files about cameras: intrinsics, boards, corners, poses and images of others' programs."""
