"""The live view of an arm in the browser; it needs the extra ``view``, everything else does without."""
