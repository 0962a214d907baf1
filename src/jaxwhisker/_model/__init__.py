"""What users build: whiskers, objects, supports, motions, scenes."""
