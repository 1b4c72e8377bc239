"""From host scenes to host graphs, whatever the model: checks, batches, choices among samples."""
