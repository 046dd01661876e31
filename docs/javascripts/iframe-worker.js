// A page that is opened from the file system may not start a worker, which the theme's search asks for.  There a
// hidden frame runs the worker's script in its place.
if (location.protocol === 'file:') {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement('iframe');
      frame.hidden = true;
      document.body.append(frame);
      const inside = (this.inside = frame.contentWindow);
      inside.document.open();
      inside.document.close();
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent('message', { data }));
      const script = inside.document.createElement('script');
      this.loaded = new Promise((done, failed) => {
        script.onload = done;
        script.onerror = () => failed(new Error(`${url} can't be loaded`));
      });
      script.src = url;
      inside.document.head.append(script);
    }

    async postMessage(data) {
      await this.loaded;
      this.inside.dispatchEvent(new this.inside.MessageEvent('message', { data }));
    }
  };
}
