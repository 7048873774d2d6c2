"""``hframe-post batch``: many files, each as if it were alone, here or on a cluster."""
