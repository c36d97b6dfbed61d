// The last program: show the frame and the view of the page's address.

async function begin() {
  try {
    const page = new Page(JSON.parse(element("data").textContent));
    await page.fromHash(location.hash);
    document.documentElement.dataset.ready = "1";
  } catch (error) {
    element("message").textContent = error.message;
  }
}

begin();
