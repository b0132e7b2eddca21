"""The 3-D scene in the browser. The only room that imports viser."""
