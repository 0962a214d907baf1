"""Parts of a scene that users build: whiskers, objects, supports, motions."""
