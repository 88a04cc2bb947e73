// BokehJS takes a mouse that rests after it went down for a long press, and the drag that follows for nothing:
// who grips a pole with care would never move it. Nothing here is pressed for long.
const gestures = window.Bokeh?.loader?.["core/ui_gestures"]?.UIGestures;
if (gestures) gestures.press_threshold = 1e9; // milliseconds
