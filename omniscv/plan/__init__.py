"""From a camera and a pose to the views that its image needs: one file per strategy."""
