"""What has drifted since a profile was identified, from a short run."""
