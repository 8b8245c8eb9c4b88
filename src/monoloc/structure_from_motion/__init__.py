"""Structure from motion: poses, depth and intrinsics of a plain video, by pycolmap (extra ``sfm``)."""
