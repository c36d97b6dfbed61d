"""Images for people: pages to look around in, contact sheets, truth drawn over pictures, Rerun files."""
