// BokehJS takes a mouse that rests after it went down for a long press, and the drag that follows for nothing:
// who grips a pole with care would never move it. Nothing here is pressed for long.
const loaded = (name) => window.Bokeh?.loader?.[name] ?? {};
const { UIGestures } = loaded("core/ui_gestures");
if (UIGestures) UIGestures.press_threshold = 1e9; // milliseconds

// What drags a handle is no drag of the figure, and the server is not told when it begins and ends: it takes a mouse
// that is held still for one that was let go.
const { BoxAnnotationView } = loaded("models/annotations/box_annotation");
const { PanStart, PanEnd } = loaded("core/bokeh_events");
if (BoxAnnotationView && PanStart && PanEnd) {
  const tell = (view, Event, { sx, sy, modifiers }) => {
    const { x_scale: x, y_scale: y } = view.plot_view.frame;
    view.plot_view.model.trigger_event(new Event(sx, sy, x.invert(sx), y.invert(sy), modifiers));
  };
  const { on_pan_start: begin, on_pan_end: end } = BoxAnnotationView.prototype;
  BoxAnnotationView.prototype.on_pan_start = function (event) {
    const taken = begin.call(this, event);
    if (taken) tell(this, PanStart, event);
    return taken;
  };
  BoxAnnotationView.prototype.on_pan_end = function (event) {
    end.call(this, event);
    tell(this, PanEnd, event);
  };
}
