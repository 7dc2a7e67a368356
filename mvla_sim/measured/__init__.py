"""From a laboratory's folder, or a scene, to an image, its binary result and figures of merit."""
